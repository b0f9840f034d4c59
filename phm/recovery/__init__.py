"""Recovery: decides what to do about a fault, acts, and verifies that it helped.

One restart in reading order: `executor` gives the fault to the `worker` of its target. `fault_cases` has what is known about
the target: its open faults, and what was tried. The worker has `policy` decide. An `attempt` locks the target (`ownership`),
runs the action (`base`, `actions.restart`) on an engine that respects the armed state, verifies by check runs
(`verification`), and releases the target. tests/recovery/test_restart_path.py measures this list.

A restart enters the other packages only where they are needed: `safety` if a container is flight-critical, `holds` and
`operator` if people have requested something. `persistence` keeps what survives a restart of PHM.
"""
