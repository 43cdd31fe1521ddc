"""Tests. As in the command, and before anything imports torch: OpenMP's threads sleep between loops."""

from stylerf.environment.performance import wait_passively

wait_passively()
