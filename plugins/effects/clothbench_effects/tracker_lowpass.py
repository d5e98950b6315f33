"""`tracker_lowpass`: the tracker smooths what it sees, so that it trails behind fast motion."""

import numpy as np

from clothbench import Parameter, ParameterSpace


class TrackerLowpass:
    """τ ẏ = x − y from y = x in the first frame, exact for positions x that move evenly between the stamps."""

    name = "tracker_lowpass"
    version = 1
    place = "sensor"
    family = "clock"
    summary = "positions smoothed by a first-order filter"
    parameters = ParameterSpace(
        (
            Parameter(
                "time", "τ", "s", (0.0, 0.2), "linear", 0.01, "time constant", "settings of the tracking software",
                null=0.0,
            ),
        )
    )  # fmt: skip

    def positions(self, time: np.ndarray, position: np.ndarray, points: np.ndarray, phi: np.ndarray) -> np.ndarray:
        if phi[0] == 0.0:
            return position
        step = np.diff(time)
        lag = phi[0] * np.diff(position, axis=0) / step[:, None, None]  # how far it trails a steady motion
        kept = np.exp(-step / phi[0])
        out = np.array(position)
        for k in range(len(step)):
            out[k + 1] = position[k + 1] - lag[k] + kept[k] * (out[k] - position[k] + lag[k])
        return out
