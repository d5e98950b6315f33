"""How fast models step, beside the installed peers."""
