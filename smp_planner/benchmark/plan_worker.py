"""A process that plans the scenes that it is sent, for any version of this package.

It is run as a file, with the version to be measured on the path, and so uses only what every
version has. A line of JSON asks on the standard input, a line of JSON answers.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any


def _policy(task: str, settings: dict[str, Any]) -> Any:
    try:
        from smp_planner.policy.planner_policy import PlannerPolicy
    except ImportError:
        from smp_planner.policy import PlannerPolicy  # type: ignore[no-redef,attr-defined]
    method = settings.pop("method", "smp")
    return PlannerPolicy.make(method, task, settings=settings)


class _Worker:
    def __init__(self) -> None:
        self._policies: dict[str, Any] = {}
        self._environments: dict[str, Any] = {}

    def problem(self, policy: Any, task: str, scene: str) -> Any:
        """Return the problem of a scene's first observation."""
        import gymnasium

        import smp_gym  # noqa: F401  (registers the environments)
        from smp_gym.scene import Scene

        if task not in self._environments:
            self._environments[task] = gymnasium.make(
                f"smp_gym/{task}-v0", disable_env_checker=True
            )
        environment = self._environments[task]
        observation, _ = environment.reset(options={"scene": Scene.from_json(scene)})
        return policy.problem(observation)

    def answer(self, request: dict[str, Any]) -> dict[str, Any]:
        """Return what one plan took, and how good it is."""
        import torch

        key = json.dumps([request["task"], request["settings"]])
        if key not in self._policies:
            self._policies[key] = _policy(request["task"], request["settings"])
        policy = self._policies[key]
        torch.set_num_threads(request["threads"])
        problem = self.problem(policy, request["task"], request["scene"])
        wall, cpu = time.perf_counter(), time.process_time()
        (plan,) = policy.planner.plan([problem])
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        good = plan.good
        prior = plan.costs.get("prior")
        return {
            "wall": wall,
            "cpu": cpu,
            "stages": dict(plan.timings),
            "good": float(good.mean()),
            "solved": bool(good.any()),
            "chosen": bool(good[plan.chosen]),
            "prior": float(prior[good].mean()) if prior is not None and good.any() else None,
            "modes": int(plan.modes.count),
        }


def _serve() -> None:
    # What libraries print must not get between the answers.
    answers, sys.stdout = sys.stdout, sys.stderr
    worker = _Worker()
    for line in sys.stdin:
        print(json.dumps(worker.answer(json.loads(line))), file=answers, flush=True)


if __name__ == "__main__":
    _serve()
