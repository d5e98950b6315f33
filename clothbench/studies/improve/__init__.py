"""Closing the loop: from the residual of a calibrated model to the effect that it lacks, and back to the error.

One file per stage: `problem` (what is asked), `residual`, `attribution`, `guard`, `improve`, `verdict`.
"""
