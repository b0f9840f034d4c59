"""Recovery: decides what to do about a fault, acts, and verifies that it helped.

One restart in reading order: `executor` passes the fault to the `worker` of its target, which decides by `policy` and
`history`. An `attempt` locks the target (`safety.target_locks`), runs the action (`actions.restart`) on an engine that
respects the armed state (`safety.guarded_engine`), verifies by check runs (`verification`), and releases the target.

`containers` has what recovery knows about containers, `holds` and `operator` what people request, `persistence` what
survives a restart of PHM.
"""
