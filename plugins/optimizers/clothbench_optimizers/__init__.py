"""The built-in optimizers: registration only, each is imported when it is used."""

from clothbench import Registration, hookimpl


@hookimpl
def clothbench_optimizers():
    return [
        Registration("ga", "clothbench_optimizers.ga:GeneticAlgorithm", "genetic algorithm on 16-bit genes"),
        Registration(
            "annealing",
            "clothbench_optimizers.annealing:Annealing",
            "downhill simplex with Metropolis fluctuations, from the best of an exhaustive grid",
        ),
        Registration(
            "simple_ea",
            "clothbench_optimizers.evolution:SimpleEa",
            "evolution towards a front of several objectives (pymoo's NSGA-II)",
        ),
        Registration(
            "hybrid_ea",
            "clothbench_optimizers.evolution:HybridEa",
            "the same with local search on the front, and a search of the stability domain",
        ),
        Registration(
            "tpe", "clothbench_optimizers.tpe:Tpe", "model-based search towards one goal or several (Optuna's TPE)"
        ),
        Registration("nelder_mead", "clothbench_optimizers.nelder_mead:NelderMead", "SciPy's simplex, restarted"),
        Registration(
            "cma_es", "clothbench_optimizers.cma_es:CmaEs", "covariance matrix adaptation evolution strategy (pycma)"
        ),
        Registration(
            "iterative_least_squares",
            "clothbench_optimizers.iterative_least_squares:IterativeLeastSquares",
            "Levenberg–Marquardt that goes on from the last estimate with every new measurement",
        ),
        Registration(
            "least_squares",
            "clothbench_optimizers.least_squares:LeastSquares",
            "batched finite-difference Levenberg–Marquardt from the best of a spread of starts",
        ),
    ]
