"""For authors of models and effects: the sheet, its mesh, compiled kernels, and effects made ready for a time loop."""
