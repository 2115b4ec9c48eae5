"""Rollouts that several tests compare."""

import hashlib

import numpy as np


def rollout_digest(env, scene, steps=80):
    """Return a digest of an episode that moves, drops the object and runs into things."""
    rng = np.random.default_rng(scene.seed)
    observation, _ = env.reset(options={"scene": scene})
    digest = hashlib.sha256()
    for step in range(steps):
        if step % 20 == 0:
            action = rng.uniform(-0.6, 0.6, 7).astype(np.float32)
            action[6] = 1.0 if step < 40 else -1.0
        for key in sorted(observation):
            digest.update(observation[key].tobytes())
        # On past collisions: what they leave behind must not reach the next episode.
        observation, reward, _, _, info = env.step(action)
        digest.update(np.array([reward, info["clearance"]]).tobytes())
    return digest.hexdigest()
