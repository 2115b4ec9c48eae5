"""Measure methods on paired episodes: the same as the installed command ``smp-bench``."""

from smp_gym.console_script import require_for_script

require_for_script()

from smp_planner.benchmark.cli import app

if __name__ == "__main__":
    app()
