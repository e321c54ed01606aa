"""Entry point of the command `tosvert-gateway` and of `python -m gateway`."""

from __future__ import annotations

from gateway.cli import run_command


def main() -> None:
    """Run the command line."""
    run_command()


if __name__ == "__main__":
    main()
