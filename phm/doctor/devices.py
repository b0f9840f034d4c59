"""Serial ports, and the devices that the configuration names."""

from __future__ import annotations

import os
from collections.abc import Iterator

from phm.doctor.context import DoctorContext
from phm.doctor.row import Row, limited, missing, ok
from phm.probes.serial_port_users import users
from phm.setup.discovery import serial_ports


def rows(context: DoctorContext) -> Iterator[Row]:
    dev = context.dev
    if not dev.is_dir():
        yield missing("folder", f"{dev} does not exist", "mount the host's /dev there, or correct host.dev_root")
        return
    ports = [port.path for port in serial_ports(dev, context.endpoint_ports)]
    if not ports:
        yield ok("serial ports", "none")
    for path in ports:
        taken = users(str(dev / path.removeprefix("/dev/")), context.proc)
        yield ok(path, f"in use by {', '.join(taken)}" if taken else "present")
    for entry in context.settings.containers:
        for device in entry.devices:
            there = dev / os.path.relpath(device.path, "/dev")
            if device.path.startswith("/dev/") and not os.path.exists(there):
                text = f"{device.path} of container {entry.key} does not exist"
                yield limited(device.path, text, "connect the device, or correct its path: ls /dev/serial/by-id")
