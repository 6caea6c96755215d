"""Where tags and scans come from when they do not come from the base: `ros2:`, `rosbridge:` or `socket:`.

Each connection has a process of its own, as a base has: GTSAM holds the interpreter for seconds, and meanwhile nothing
may be lost and no sender kept waiting.
"""

from __future__ import annotations

import dataclasses
import urllib.parse
from collections.abc import Mapping
from typing import TypeVar

from tfg_drake.hardware.device import Device, DeviceError, DriverConfig
from tfg_drake.hardware.ros.preset import Preset
from tfg_drake.messages import LaserScan, TagDetections

T = TypeVar("T", LaserScan, TagDetections)

# What a source may be asked for, and what that is.
KINDS = {"tags": TagDetections, "scan": LaserScan}

ROSBRIDGE_PORT = 9090
_FORMS = "ros2:/TOPIC, rosbridge:HOST:PORT/TOPIC or socket:HOST:PORT"


@dataclasses.dataclass(frozen=True)
class SourceSpec:
    """Where a sensor is. transport: "ros2", "rosbridge" or "socket". topic: empty of a socket."""

    transport: str
    host: str = ""
    port: int = 0
    topic: str = ""


def parse_source(text: str) -> SourceSpec:
    """What `ros2:/TOPIC`, `rosbridge:HOST:PORT/TOPIC` or `socket:HOST:PORT` says; raises DeviceError.

    Of rosbridge the port (9090) and the host (localhost) may be left out: `rosbridge:HOST/TOPIC`, `rosbridge:/TOPIC`.
    """
    transport, _, rest = text.partition(":")
    if transport not in ("ros2", "rosbridge", "socket") or not rest:
        raise DeviceError(f"{text}: is no source; name one as {_FORMS}")
    if transport == "ros2":
        return SourceSpec(transport, topic=_topic(text, rest if rest.startswith("/") else f"/{rest}"))
    address, slash, topic = rest.partition("/")
    try:
        url = urllib.parse.urlsplit(f"//{address}")
        host, port = url.hostname or "", url.port
    except ValueError:
        raise DeviceError(f"{text}: {address} is no HOST:PORT; name the source as {_FORMS}") from None
    if transport == "rosbridge":
        return SourceSpec(transport, host or "localhost", port or ROSBRIDGE_PORT, _topic(text, slash + topic))
    if not host or not port or slash:
        raise DeviceError(f"{text}: {rest} is no HOST:PORT; name the source as socket:HOST:PORT")
    return SourceSpec(transport, host, port)


def _topic(text: str, topic: str) -> str:
    if len(topic) < 2 or any(character.isspace() for character in topic):
        raise DeviceError(f"{text}: names no topic; name the source as {_FORMS}")
    return topic


class SensorSource:
    """Tags or scans, or both, of one connection. Stamps are the host's monotonic clock, s."""

    def __init__(self, config: DriverConfig) -> None:
        """Waits until what is wanted arrives; raises DeviceError."""
        self._device = Device(config)

    def newest(self, kind: type[T]) -> T | None:
        """The newest message of a kind; None where none has arrived yet."""
        return self._device.newest(kind)

    def take(self, kind: type[T], until: float) -> list[T]:
        """The messages of a kind that are stamped `until` (s) or before and were not taken yet, in order."""
        return self._device.take(kind, until)

    def close(self) -> None:
        """Ends the connection; once is enough."""
        self._device.close()


def open_sources(specs: Mapping[str, str], preset: Preset) -> dict[str, SensorSource]:
    """The sources of "tags" and "scan", each as `parse_source` reads it; raises DeviceError, and leaves none open.

    preset: of the robot, for the mounts of scanner and camera. What has the same server, or ROS 2's graph, shares one
    source.
    """
    parsed = {use: parse_source(text) for use, text in specs.items()}
    uses_of: dict[SourceSpec, list[str]] = {}
    for use, spec in parsed.items():
        uses_of.setdefault(dataclasses.replace(spec, topic=""), []).append(use)
    sources: dict[str, SensorSource] = {}
    try:
        for spec, uses in uses_of.items():
            source = SensorSource(_config(spec, [(use, parsed[use].topic) for use in uses], preset))
            sources |= dict.fromkeys(uses, source)
    except DeviceError:
        for source in sources.values():
            source.close()
        raise
    return sources


def _config(spec: SourceSpec, topics: list[tuple[str, str]], preset: Preset) -> DriverConfig:
    if spec.transport == "socket":
        from tfg_drake.hardware.socket_sensors import SocketConfig

        return SocketConfig(spec.host, spec.port, tuple(KINDS[use] for use, _ in topics))
    from tfg_drake.hardware.ros.sensors import SensorConfig

    return SensorConfig(tuple(topics), preset, spec.host if spec.transport == "rosbridge" else None, spec.port)
