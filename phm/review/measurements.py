"""Which measurements a report keeps for its plots, and the plot that each belongs to."""

from __future__ import annotations

GROUPS = (
    ("hz", "Topic rates", "Hz"),
    ("cpu_percent", "CPU", "%"),
    ("memory_percent", "Memory", "%"),
    ("temperature_c", "Temperature", "°C"),
    ("disk_percent", "Disk", "%"),
    ("rssi", "Radio, received signal", ""),
    ("remrssi", "Radio, signal at the other end", ""),
    ("noise", "Radio, noise", ""),
    ("remnoise", "Radio, noise at the other end", ""),
    ("margin", "Radio, signal above the noise", ""),
    ("remmargin", "Radio, signal above the noise at the other end", ""),
    ("rxerrors_s", "Radio, damaged packets", "1/s"),
    ("txbuf", "Radio, free buffer", "%"),
    ("loss_", "Frames that did not arrive, by sender", "%"),
    ("tx_bytes_s", "Radio bytes sent by PHM's links", "B/s"),
    ("rx_bytes_s", "Bytes received", "B/s"),
)
"""Beginning of the names of the values, title and unit of the plot. What is here is kept, and what is kept is drawn."""
PLOTTED = tuple(key for key, _, _ in GROUPS)
