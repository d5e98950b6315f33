"""The built-in effects: registration only, each is imported when it is used."""

from clothbench.hookspecs import Registration, hookimpl


@hookimpl
def clothbench_effects():
    return [
        Registration(
            "added_mass", "clothbench_effects.added_mass:AddedMass", "air carried along by the normal acceleration"
        ),
        Registration(
            "quadratic_drag", "clothbench_effects.quadratic_drag:QuadraticDrag", "air drag, quadratic in velocity"
        ),
        Registration(
            "clock_offset", "clothbench_effects.clock_offset:ClockOffset", "positions are stamped late or early"
        ),
    ]
