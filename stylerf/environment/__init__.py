"""Protects the process from its environment: untrusted files, the current folder, library configuration."""
