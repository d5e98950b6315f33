"""Twins: what was calibrated, made ready to leave for another simulator."""
