"""The ground station `phm gcs`: receives, shows, records and serves the status of all agents. `docs/reference/gcs.md`.

`fleet_state` and what it uses (`frames`, `statustext_parser`, `presence`, `agent`, `hops`, `events`) is pure. `station` receives;
`console`, `recorder` and `server` publish.
"""
