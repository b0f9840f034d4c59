"""The routes of the server: each module has `routes(site)`, and is found by itself. A handler says who may use it
(`phm.gcs.web.access`)."""
