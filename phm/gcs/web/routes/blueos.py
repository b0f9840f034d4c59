"""What BlueOS asks a page for, to list it in its menu: https://blueos.cloud/docs/latest/development/extensions/."""

from __future__ import annotations

from collections.abc import Sequence

from aiohttp import web

from phm import __version__
from phm.gcs.web.access import answer, public
from phm.gcs.web.site import Site

SERVICE = {
    "name": "PHM",
    "description": "What failed on this vehicle, at which layer, and whether it recovered.",
    "icon": "mdi-heart-pulse",
    "company": "The PHM authors",
    "version": __version__,
    "avoid_iframes": True,
    "webpage": "",
    "api": "",
}
"""avoid_iframes: the page allows no other page to frame it (`frame-ancestors 'none'`). webpage, api: none but the page itself."""


def routes(site: Site) -> Sequence[web.RouteDef]:
    async def register(request: web.Request) -> web.Response:
        return answer(SERVICE)

    return [web.get("/register_service", public(register))]
