"""Settings for Hydra: `clothbench run +suite=xpbd`."""
