"""What people see: tables, the gate, pages and Rerun files. Reads results; computes none."""
