"""Protects the process from its surroundings: untrusted files, the current folder, configuration of libraries."""
