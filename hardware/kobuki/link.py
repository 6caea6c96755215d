"""What the driver's process and its parent say to each other: JSON datagrams, the newest of which counts."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np

from tfg_drake.messages import Hazards, Odometry


class KobukiError(Exception):
    """The base cannot be used; the message is one line that names the culprit and the mend."""


@dataclasses.dataclass(frozen=True)
class Report:
    """How the base is, as of its newest frame.

    state: "disconnected", "disabled" (it answers, and stands until it is enabled) or "enabled". detail: why it is
    disconnected and what to do about it, one line, "" as long as that is not known. connection: how often it has been
    connected. odometry, hazards: None while disconnected; stamps are s of time.monotonic(), X_OB is 0 where the first
    connection began. battery: V. charging: by dock or adapter. firmware, hardware: versions such as "1.1.4".
    unique_id: in hexadecimal. bad_frames: beginnings of frames that were garbled.
    """

    state: str = "disconnected"
    detail: str = ""
    connection: int = 0
    odometry: Odometry | None = None
    hazards: Hazards | None = None
    battery: float = 0.0
    charging: bool = False
    firmware: str = ""
    hardware: str = ""
    unique_id: str = ""
    bad_frames: int = 0


def encode_report(report: Report) -> bytes:
    """The report as a datagram."""
    fields: dict[str, Any] = {field.name: getattr(report, field.name) for field in dataclasses.fields(report)}
    if (odometry := report.odometry) is not None:
        fields["odometry"] = [odometry.stamp, odometry.X_OB.tolist(), odometry.V_B.tolist(), odometry.at_rest]
    if (hazards := report.hazards) is not None:
        fields["hazards"] = [hazards.stamp, hazards.bumper, hazards.cliff, hazards.wheel_drop]
    return json.dumps(fields).encode()


def decode_report(datagram: bytes) -> Report:
    """encode_report backwards."""
    fields = json.loads(datagram)
    if fields["odometry"] is not None:
        stamp, pose, speed, at_rest = fields["odometry"]
        fields["odometry"] = Odometry(stamp, np.array(pose), np.array(speed), at_rest)
    if fields["hazards"] is not None:
        fields["hazards"] = Hazards(*fields["hazards"])
    return Report(**fields)


@dataclasses.dataclass(frozen=True)
class Request:
    """What the parent wants: to enable the connection of this number, or, without one, a velocity.

    stamp: when it was said, s of time.monotonic(). speed: m/s. turn_rate: rad/s.
    """

    stamp: float
    enable: int | None = None
    speed: float = 0.0
    turn_rate: float = 0.0


def encode_request(request: Request) -> bytes:
    """The request as a datagram."""
    return json.dumps(dataclasses.asdict(request)).encode()


def decode_request(datagram: bytes) -> Request:
    """encode_request backwards."""
    return Request(**json.loads(datagram))
