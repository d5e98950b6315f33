"""`grip_compliance`: the gripper gives way: it is not quite where it was sent."""

import numpy as np

from clothbench import Parameter, ParameterSpace

SOURCE = "Meirovitch, Fundamentals of Vibrations, ch. 2: a damped oscillator driven at its base"


class GripCompliance:
    """y'' + 2 ζ ω y' + ω² (y − c) = 0 with ω = 2π/T: the grip y follows its commanded path c, from rest.

    A path that is in motion at its first stamp, as where a run goes on from a motion that was seen, makes the mount
    ring at first, for about T/(2π ζ); on a path with a single stamp it does nothing, and after the last stamp it
    stands still, since what is seen then counts for nothing.

    Integrated exactly, from stamp to stamp, for a path that is straight between them; at T → 0 it is the path. What a
    model then makes of the stamps is as smooth as of any: of grips that stop at once, a mount with five stamps a period
    is off by 5 to 20 % of what it gave way, and with two or fewer by all of it.
    """

    name = "grip_compliance"
    version = 1
    place = "boundary"
    family = "grip"
    summary = "grips that follow their path like a damped spring mount"
    parameters = ParameterSpace(
        (
            Parameter("period", "T", "s", (0.0, 0.5), "linear", 0.05, "natural period of the mount", SOURCE, null=0.0),
            Parameter("damping", "ζ", "1", (0.02, 2.0), "log", 0.3, "its damping ratio", SOURCE),
        )
    )  # fmt: skip

    def grips(self, time: np.ndarray, position: np.ndarray, phi: np.ndarray) -> np.ndarray:
        period, damping = phi
        if period == 0.0:
            return position
        omega, step = 2 * np.pi / period, np.diff(time)
        # For c = c₀ + r t the mount lags steadily by 2ζr/ω; what differs from that rings freely.
        free = ringing(omega, damping, step)
        rate = np.diff(position, axis=0) / step[:, None, None]
        out, speed = np.array(position), np.zeros_like(position[0])
        for k, (r, phase) in enumerate(zip(rate, free, strict=True)):
            lag = 2 * damping / omega * r
            away, drift = out[k] - position[k] + lag, speed - r
            out[k + 1] = position[k + 1] - lag + phase[0, 0] * away + phase[0, 1] * drift
            speed = r + phase[1, 0] * away + phase[1, 1] * drift
        return out


def ringing(omega: float, damping: float, step: np.ndarray) -> np.ndarray:
    """(K, 2, 2): exp(A Δt) with A = [[0, 1], [−ω², −2ζω]], what becomes of offset and speed over each step (K,) s."""
    own = np.array([[0.0, 1.0], [-(omega**2), -2 * damping * omega]])
    turn = omega * np.sqrt(complex(1 - damping**2))  # imaginary where it creeps back
    one, other = (np.exp((-damping * omega + sign * turn) * step) for sign in (1j, -1j))
    swing = (one + other).real / 2
    critical = abs(turn * step) < 1e-6
    lead = np.where(critical, step * swing, ((one - other) / (2j * turn if turn else 1.0)).real)
    return swing[:, None, None] * np.eye(2) + lead[:, None, None] * (own + damping * omega * np.eye(2))
