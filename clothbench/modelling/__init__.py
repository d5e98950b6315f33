"""For authors of models and effects: what the built-in ones share, public and documented.

compiled code, cached by the content of its sources: kernel, fast_kernel, apart_kernel, effect_kernel, bundle_type
the sheet as compiled code sees it: Sheet, SHEET (its numba type), sheet_of, own_sheet, grid_normals, sheet_normals,
    wants_normals, bear_inertia
meshes: grid_triangles, gradient_weights, curvature_weights, triangle_slots
a grid over a scene, cut to its outline, and a batch of parameter sets on it: Cover, spaces, grid_shape, grid_lines,
    even_count, tributary, GridSimulation, GridBatch, check_resolution, check_number
parameters of a model and its effects in one space: JoinedParameters
effects in a time loop: BoundEffects, EFFECT (their numba type), Terms, SLOTS, FORCE, INERTIA, no_effect, ready,
    add_effects, apply_effects, show_grips
start, grips, sampling and the end of a time loop: Start, Grips, Sampling, Clock (numba types in capitals, and
    `…_OF_MANY` for loops that run several members at once), GOES_ON, SETTLES, RESTS, grip_point, grip_speed,
    advance_segment, hold_grips, write_frames, put_grips, fastest, is_lost, as_double, put_back, OK, DIVERGED
contact: obstacle_table, carry, keep_out, inside, layers_of, keep_apart, LAYERS
force-extension curves: curve_of, CurveSimulation
threads over members, and the shape to settle from: for_each, initial_shape
"""

from clothbench.core.kernels import apart_kernel, bundle_type, fast_kernel, kernel
from clothbench.core.parallel import for_each
from clothbench.core.scene import initial_shape
from clothbench.modelling.batch import GridBatch, GridSimulation
from clothbench.modelling.bound_effects import FORCE, INERTIA, PLACES, BoundEffects
from clothbench.modelling.contact import DISC, PLANE, SPHERE, carry, inside, keep_out, obstacle_table
from clothbench.modelling.cover import Cover, spaces
from clothbench.modelling.curves import (
    CURVE_HOOKS,
    SHEET_HOOKS,
    CurveRollout,
    CurveSimulation,
    acts_on_curves,
    acts_on_sheets,
    answers_curves,
    answers_sheets,
    curve_of,
)
from clothbench.modelling.grid import check_number, check_resolution, even_count, grid_lines, grid_shape, tributary
from clothbench.modelling.joined import JoinedParameters
from clothbench.modelling.kernels import EFFECT, SIGNATURE, effect_kernel, no_effect, ready
from clothbench.modelling.mesh import curvature_weights, gradient_weights, grid_triangles, triangle_slots
from clothbench.modelling.self_contact import LAYERS, Layers, keep_apart, layers_of
from clothbench.modelling.sheet import (
    SHEET,
    Sheet,
    bear_inertia,
    grid_normals,
    own_sheet,
    sheet_normals,
    sheet_of,
    wants_normals,
)
from clothbench.modelling.time_loop import (
    CLOCK,
    DIVERGED,
    GOES_ON,
    GRIPS,
    GRIPS_OF_MANY,
    OK,
    RESTS,
    SAMPLING,
    SAMPLING_OF_MANY,
    SETTLES,
    SLOTS,
    START,
    TERMS,
    TERMS_OF_MANY,
    Clock,
    Grips,
    Sampling,
    Start,
    Terms,
    add_effects,
    advance_segment,
    apply_effects,
    as_double,
    fastest,
    grip_point,
    grip_speed,
    hold_grips,
    is_lost,
    put_back,
    put_grips,
    show_grips,
    write_frames,
)

__all__ = [
    "CLOCK",
    "CURVE_HOOKS",
    "DISC",
    "DIVERGED",
    "EFFECT",
    "FORCE",
    "GOES_ON",
    "GRIPS",
    "GRIPS_OF_MANY",
    "INERTIA",
    "LAYERS",
    "OK",
    "PLACES",
    "PLANE",
    "RESTS",
    "SAMPLING",
    "SAMPLING_OF_MANY",
    "SETTLES",
    "SHEET",
    "SHEET_HOOKS",
    "SIGNATURE",
    "SLOTS",
    "SPHERE",
    "START",
    "TERMS",
    "TERMS_OF_MANY",
    "BoundEffects",
    "Clock",
    "Cover",
    "CurveRollout",
    "CurveSimulation",
    "GridBatch",
    "GridSimulation",
    "Grips",
    "JoinedParameters",
    "Layers",
    "Sampling",
    "Sheet",
    "Start",
    "Terms",
    "acts_on_curves",
    "acts_on_sheets",
    "add_effects",
    "advance_segment",
    "answers_curves",
    "answers_sheets",
    "apart_kernel",
    "apply_effects",
    "as_double",
    "bear_inertia",
    "bundle_type",
    "carry",
    "check_number",
    "check_resolution",
    "curvature_weights",
    "curve_of",
    "effect_kernel",
    "even_count",
    "fast_kernel",
    "fastest",
    "for_each",
    "gradient_weights",
    "grid_lines",
    "grid_normals",
    "grid_shape",
    "grid_triangles",
    "grip_point",
    "grip_speed",
    "hold_grips",
    "initial_shape",
    "inside",
    "is_lost",
    "keep_apart",
    "keep_out",
    "kernel",
    "layers_of",
    "no_effect",
    "obstacle_table",
    "own_sheet",
    "put_back",
    "put_grips",
    "ready",
    "sheet_normals",
    "sheet_of",
    "show_grips",
    "spaces",
    "triangle_slots",
    "tributary",
    "wants_normals",
    "write_frames",
]
