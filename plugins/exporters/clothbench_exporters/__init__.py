"""The built-in targets of `clothbench export`: registration only, each is imported when it is used."""

from clothbench import Registration, hookimpl


@hookimpl
def clothbench_exporters():
    return [
        Registration("mujoco", "clothbench_exporters.mjcf", "MJCF with a flex; grips are mocap bodies"),
        Registration(
            "newton", "clothbench_exporters.newton_script", "Python script that builds and runs Newton's cloth"
        ),
        Registration("usd", "clothbench_exporters.usd", "USD mesh with the proposed schema of surface deformables"),
        Registration("ppf", "clothbench_exporters.ppf", "material profile of ppf-contact-solver, a shell"),
        Registration("json", "clothbench_exporters.plain", "numbers with units, intervals and provenance"),
    ]
