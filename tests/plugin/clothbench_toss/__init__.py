"""A toy study: tosses coins, and knows nothing of cloth. This folder and this registration are all that it takes."""

from clothbench import Registration, hookimpl


@hookimpl
def clothbench_studies():
    return [Registration("toss", "clothbench_toss.study", "coins instead of cloth")]
