"""The front door: argparse, one module a verb, the only code that prints."""
