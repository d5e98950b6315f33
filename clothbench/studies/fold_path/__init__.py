"""A strip or a sheet folded in half along a gripper's path: where its edge lands, and how far it slips on the desk."""
