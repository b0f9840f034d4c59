"""Keys of the objects that a handler finds in its aiohttp application."""

from __future__ import annotations

from aiohttp import web

from phm.gcs.web.access import AccessControl
from phm.gcs.web.clients import Clients

ACCESS: web.AppKey[AccessControl] = web.AppKey("access", AccessControl)
CLIENTS: web.AppKey[Clients] = web.AppKey("clients", Clients)
