"""The ground station `phm gcs`: what the agents of a MAVLink network say, kept, shown, recorded and served. `docs/reference/gcs.md`.

`store` and what it uses (`frames`, `lines`, `presence`, `agent`, `hops`, `news`) is pure; `station` hears, `record` and `serve` tell.
"""
