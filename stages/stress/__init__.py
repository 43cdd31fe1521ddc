"""Where methods fail: faults by name, what counts as success, cells of methods and faults, what a baseline holds."""
