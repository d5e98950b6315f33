"""Work on the workers of another engine: Dask, Ray, or Slurm by submitit. None of them is imported before it is asked for."""
