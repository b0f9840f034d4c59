"""Compares the ROS environment of an application with PHM's: why PHM may not receive its nodes. Pure.

What each difference does was measured with Fast DDS (`sitl.bench.ros_environments`; table in docs/reference/ros.md).
"""

from __future__ import annotations

from collections.abc import Iterator

from phm.facts import EnvironmentDifference, RosEnvironment

DEFAULT_RMW = "rmw_fastrtps_cpp"
_FAST_DDS = (DEFAULT_RMW, "rmw_fastrtps_dynamic_cpp")
_UDP = ("", "DEFAULT", "UDPv4")
"""Values of FASTDDS_BUILTIN_TRANSPORTS with which a process can be reached over UDP on IPv4."""
_OF_MIDDLEWARE = {"rmw_cyclonedds_cpp": "CYCLONEDDS_URI", "rmw_zenoh_cpp": "ZENOH_SESSION_CONFIG_URI"}
OWN_PROFILE = "/etc/phm/fastdds.xml"
"""Where images have PHM's profile, which changes leases alone (config/fastdds.xml)."""
COPIED_PROFILE = "/etc/phm/application-fastdds.xml"
"""A copy of the application's profile that `phm init` made for PHM."""
SUBNET, LOCALHOST, OFF = "SUBNET", "LOCALHOST", "OFF"


def differences(
    application: RosEnvironment, phm: RosEnvironment, *, configured_domain: bool = False
) -> tuple[EnvironmentDifference, ...]:
    """What may keep PHM from receiving the application's nodes; certain differences first.

    configured_domain: PHM's domain is that of `ros.domain` in phm.yaml.
    """
    found = [
        *_middleware(application, phm),
        *_domain(application, phm, configured=configured_domain),
        *_network(application, phm),
        *_range(application, phm),
        *_peers(application, phm),
        *_discovery_server(application, phm),
        *_security(application, phm),
        *_transports(application, phm),
        *_middleware_file(application, phm),
    ]
    return tuple(sorted(found, key=lambda one: not one.certain))


def rmw(environment: RosEnvironment) -> str:
    """The middleware of its processes."""
    return environment.variables.get("RMW_IMPLEMENTATION") or DEFAULT_RMW


def discovery_range(environment: RosEnvironment) -> str:
    """The effective discovery range: ROS_LOCALHOST_ONLY=1 overrides ROS_AUTOMATIC_DISCOVERY_RANGE, as in rcl."""
    if environment.variables.get("ROS_LOCALHOST_ONLY") == "1":
        return LOCALHOST
    return environment.variables.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() or SUBNET


def same_network(application: RosEnvironment, phm: RosEnvironment) -> bool | None:
    """Whether both are in one network namespace; None: unknown."""
    if not application.network_namespace or not phm.network_namespace:
        return None
    return application.network_namespace == phm.network_namespace


# ------------------------------------------------------------ rules


def _domain(application: RosEnvironment, phm: RosEnvironment, *, configured: bool) -> Iterator[EnvironmentDifference]:
    name = "ROS_DOMAIN_ID"
    theirs, ours = application.variables.get(name, ""), phm.variables.get(name, "")
    if (theirs or "0") != (ours or "0"):
        remedy = f"set ros.domain: {theirs or 0} in phm.yaml" if configured else ""
        yield _unequal(application, name, theirs, ours, "0", remedy)


def _security(application: RosEnvironment, phm: RosEnvironment) -> Iterator[EnvironmentDifference]:
    name = "ROS_SECURITY_ENABLE"
    theirs, ours = application.variables.get(name, ""), phm.variables.get(name, "")
    if (theirs.lower() == "true") != (ours.lower() == "true"):
        yield _unequal(application, name, theirs, ours, "false")


def _middleware(application: RosEnvironment, phm: RosEnvironment) -> Iterator[EnvironmentDifference]:
    theirs, ours = rmw(application), rmw(phm)
    if theirs == ours or {theirs, ours} <= set(_FAST_DDS):
        return
    name = "RMW_IMPLEMENTATION"
    remedy = f"build PHM's image from a ROS base image that has {theirs}, and set {name}={theirs} in the sidecar's environment"
    yield _unequal(application, name, application.variables.get(name, ""), ours, DEFAULT_RMW, remedy)


def _network(application: RosEnvironment, phm: RosEnvironment) -> Iterator[EnvironmentDifference]:
    if same_network(application, phm) is not False or phm.network_namespace == "host":
        return
    who = application.name
    if application.network_namespace == "host":
        yield EnvironmentDifference(
            "network", f"{who} uses the host's network and PHM does not: set network_mode: host for the sidecar"
        )
    elif application.networks == {"none"}:
        yield EnvironmentDifference(
            "network", f"{who} runs with network_mode none, so nothing outside can reach its nodes: give it a network"
        )
    elif application.networks and phm.networks and not application.networks & phm.networks:
        theirs, ours = ", ".join(sorted(application.networks)), ", ".join(sorted(phm.networks))
        yield EnvironmentDifference(
            "network",
            f"{who} is on the Docker network {theirs} and PHM on {ours}: add {min(application.networks)} to the sidecar's "
            f"networks, or to `networks` of {who} in phm.yaml",
        )


def _range(application: RosEnvironment, phm: RosEnvironment) -> Iterator[EnvironmentDifference]:
    if "rmw_zenoh_cpp" in (rmw(application), rmw(phm)):
        return  # it does not read these variables
    theirs, ours = discovery_range(application), discovery_range(phm)
    name, who = "ROS_AUTOMATIC_DISCOVERY_RANGE", application.name
    if theirs == OFF:
        yield EnvironmentDifference(
            name, f"{name} is OFF in {who}, so its nodes discover no other process: set it to LOCALHOST or SUBNET there"
        )
    elif theirs == LOCALHOST and same_network(application, phm) is False:
        peers = _static_peers(phm)
        lines = [] if peers else [f"set ROS_STATIC_PEERS to the name or address of {who}"]
        lines += [] if ours == SUBNET else [f"remove {_range_variable(phm)}"]
        if lines:
            yield EnvironmentDifference(
                _range_variable(application),
                f"{_range_setting(application)} in {who}, so its nodes announce themselves only in its own network namespace, "
                f"and PHM is in another: {' and '.join(lines)} in the sidecar's environment, or run both on the host's network",
                certain=not peers,
            )
    elif theirs == LOCALHOST and ours not in (LOCALHOST, OFF):
        yield EnvironmentDifference(
            _range_variable(application),
            f"{_range_setting(application)} in {who} and the discovery range is {ours} in PHM: set {name}=LOCALHOST in the "
            "sidecar's environment",
            certain=same_network(application, phm) is None,
        )
    elif ours == OFF or (ours == LOCALHOST and theirs != LOCALHOST and not same_network(application, phm)):
        yield EnvironmentDifference(
            _range_variable(phm),
            f"{_range_setting(phm)} in PHM and the discovery range is {theirs} in {who}: remove {_range_variable(phm)} from "
            "the sidecar's environment",
            certain=application.exact or name in application.variables,
        )


def _peers(application: RosEnvironment, phm: RosEnvironment) -> Iterator[EnvironmentDifference]:
    """PHM reaches one that it looks for, or that looks for PHM; which address is whose is not known here."""
    if "rmw_zenoh_cpp" in (rmw(application), rmw(phm)):
        return
    theirs = _static_peers(application)
    if theirs and not _static_peers(phm):
        yield EnvironmentDifference(
            "ROS_STATIC_PEERS",
            f"ROS_STATIC_PEERS is {theirs} in {application.name} and not set in PHM: if multicast does not reach from one to the "
            f"other, set ROS_STATIC_PEERS to the name or address of {application.name} in the sidecar's environment",
            certain=False,
        )


def _static_peers(environment: RosEnvironment) -> str:
    """ROS_LOCALHOST_ONLY=1 switches them off, as in rcl."""
    only = environment.variables.get("ROS_LOCALHOST_ONLY") == "1"
    return "" if only else environment.variables.get("ROS_STATIC_PEERS", "")


def _discovery_server(application: RosEnvironment, phm: RosEnvironment) -> Iterator[EnvironmentDifference]:
    if rmw(application) not in _FAST_DDS:
        return
    for name in ("ROS_DISCOVERY_SERVER", "ROS2_EASY_MODE"):
        theirs, ours = application.variables.get(name, ""), phm.variables.get(name, "")
        if theirs != ours:
            yield _unequal(application, name, theirs, ours, "none")


def _transports(application: RosEnvironment, phm: RosEnvironment) -> Iterator[EnvironmentDifference]:
    if rmw(application) not in _FAST_DDS:
        return
    name, who = "FASTDDS_BUILTIN_TRANSPORTS", application.name
    theirs, ours = application.variables.get(name, ""), phm.variables.get(name, "")
    if theirs not in _UDP and theirs != ours:
        yield _unequal(application, name, theirs, ours, "DEFAULT", f"set {name}=UDPv4 in {who}")
    yield from _shared_memory(application, phm)
    profile = next((application.variables[key] for key in _profile_variables(application)), "")
    if profile not in ("", OWN_PROFILE) and not {profile, COPIED_PROFILE} & set(phm.variables.values()):
        yield EnvironmentDifference(
            "FASTDDS_DEFAULT_PROFILES_FILE",
            f"{who} loads the Fast DDS profile {profile} and PHM does not: if it changes transports, interfaces or "
            "discovery, mount it into the sidecar and set the same variable there",
            certain=False,
        )


def _shared_memory(application: RosEnvironment, phm: RosEnvironment) -> Iterator[EnvironmentDifference]:
    """In one network namespace Fast DDS takes the other for local and prefers shared memory, unless one side has none."""
    separate = application.ipc_namespace and phm.ipc_namespace and application.ipc_namespace != phm.ipc_namespace
    if not separate or not same_network(application, phm):
        return
    who, name = application.name, "FASTDDS_BUILTIN_TRANSPORTS"
    ours, own_profile = phm.variables.get(name, ""), next(_profile_variables(phm), "")
    if ours in ("", "DEFAULT", "SHM"):
        remedy = f"{name} is {ours or 'not set'}", f"set {name}=UDPv4 in the sidecar's environment"
    elif own_profile and discovery_range(phm) == LOCALHOST:
        remedy = f"{own_profile} is set and the discovery range is LOCALHOST", f"remove {own_profile}"
    else:
        return
    yield EnvironmentDifference(
        "ipc",
        f"PHM uses shared memory ({remedy[0]}) and shares no /dev/shm with {who}: {remedy[1]}, or share the IPC namespace",
    )


def _profile_variables(environment: RosEnvironment) -> Iterator[str]:
    """Fast DDS 3 reads the first name, Fast DDS 2 the second."""
    names = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")
    return (name for name in names if environment.variables.get(name))


def _middleware_file(application: RosEnvironment, phm: RosEnvironment) -> Iterator[EnvironmentDifference]:
    """Configuration of another middleware than Fast DDS."""
    name = _OF_MIDDLEWARE.get(rmw(application), "")
    if name and rmw(phm) == rmw(application):
        theirs, ours = application.variables.get(name, ""), phm.variables.get(name, "")
        if theirs != ours:
            yield _unequal(application, name, theirs, ours, "none", certain=False)


# ------------------------------------------------------------ sentences


def _unequal(
    application: RosEnvironment,
    name: str,
    theirs: str,
    ours: str,
    default: str,
    remedy: str = "",
    *,
    certain: bool = True,
) -> EnvironmentDifference:
    who = application.name
    line = f"set {name}={theirs}" if theirs else f"remove {name}"
    remedy = remedy or f"{line} in the sidecar's environment"
    hidden = not theirs and not application.exact
    if hidden:
        remedy += f", unless an entrypoint script of {who} sets it: {inspect_hint(who)}"
    text = (
        f"{name} is {theirs or f'not set ({default})'} in {who} and {ours or f'not set ({default})'} in PHM: {remedy}"
    )
    return EnvironmentDifference(name, text, certain and not hidden)


def inspect_hint(container: str) -> str:
    """The command that shows the environment of the application's first process, which includes what its entrypoint script set."""
    return f"`docker exec {container} cat /proc/1/environ`"


def _range_variable(environment: RosEnvironment) -> str:
    only = environment.variables.get("ROS_LOCALHOST_ONLY") == "1"
    return "ROS_LOCALHOST_ONLY" if only else "ROS_AUTOMATIC_DISCOVERY_RANGE"


def _range_setting(environment: RosEnvironment) -> str:
    name = _range_variable(environment)
    return f"{name} is {environment.variables.get(name) or f'not set ({SUBNET})'}"


def sidecar_variables(application: RosEnvironment, *, same_network: bool) -> dict[str, str]:
    """The variables that PHM's sidecar needs to discover this application. same_network: from the same network namespace; from
    another one, an application with the range LOCALHOST needs a static peer, and PHM the default range."""
    needed = ("ROS_DOMAIN_ID", "RMW_IMPLEMENTATION", "ROS_DISCOVERY_SERVER", "ROS2_EASY_MODE", "ROS_SECURITY_ENABLE")
    found = {name: application.variables[name] for name in needed if application.variables.get(name)}
    if same_network and discovery_range(application) == LOCALHOST:
        found["ROS_AUTOMATIC_DISCOVERY_RANGE"] = LOCALHOST
    middleware_file = _OF_MIDDLEWARE.get(rmw(application), "")
    if application.variables.get(middleware_file):
        found[middleware_file] = application.variables[middleware_file]
    return found
