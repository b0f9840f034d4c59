"""Keys of the objects that a handler finds in its aiohttp application."""

from __future__ import annotations

from aiohttp import web

from phm.gcs.web.access import Gate
from phm.gcs.web.clients import Clients

GATE: web.AppKey[Gate] = web.AppKey("gate", Gate)
CLIENTS: web.AppKey[Clients] = web.AppKey("clients", Clients)
