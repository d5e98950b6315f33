"""Work on the workers of another engine: Dask, Ray, or Slurm by submitit; imported when one is asked for."""
