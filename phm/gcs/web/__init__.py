"""The page of `phm gcs --web` and its server: docs/reference/web.md. Needs the extra `web` (aiohttp)."""
