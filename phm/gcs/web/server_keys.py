"""Keys of the objects that a handler finds in its aiohttp application."""

from __future__ import annotations

from aiohttp import web

from phm.gcs.web.access import AccessControl
from phm.gcs.web.clients import Clients

GATE: web.AppKey[AccessControl] = web.AppKey("gate", AccessControl)
CLIENTS: web.AppKey[Clients] = web.AppKey("clients", Clients)
