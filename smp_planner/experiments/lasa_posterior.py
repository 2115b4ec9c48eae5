"""Comparison of SVGD settings on the S: success, similarity, and truth to the posterior."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from rich.progress import track

from smp_gym.arrays import FloatArray
from smp_planner.adaptation import adaptation
from smp_planner.experiments.comparison import adapted, common_ends, reference_of
from smp_planner.experiments.lasa_scenes import (
    FIGURE_1,
    LASA_SMOOTH_STD,
    LasaScene,
    Method,
    learn,
    settings,
)
from smp_planner.experiments.paths import classes, similarity
from smp_planner.experiments.posterior import Reference, columns, exact_draws, posterior_row
from smp_planner.experiments.tables import Column, Row
from smp_planner.inference import named_settings
from smp_planner.inference.smc import SMCSettings
from smp_planner.library.smp import SMP, Circle

__all__ = [
    "EXACT",
    "POSTERIOR",
    "VARIANTS",
    "Ground",
    "Variant",
    "settings_columns",
    "settings_rows",
]

POSTERIOR = "posterior (SMC)"
"""Setting in the rows of the reference's own runs, whose spread is the reference's error."""

EXACT = "draws of it"
"""Setting in the rows of as many draws from the posterior as there are particles."""

_ADAPT_SETTINGS = settings().model_copy(update={"samples": 200})


@dataclass(frozen=True)
class Variant:
    """A scene, and the added deviation of the prior.

    Attributes:
        scene: of one shape with obstacles.
        smooth_std: mm, see `lasa_scenes.learn`.
    """

    scene: LasaScene
    smooth_std: float = LASA_SMOOTH_STD


def _scene(*circles: tuple[float, float, float]) -> LasaScene:
    obstacles = tuple(Circle((x, y), radius) for x, y, radius in circles)
    return LasaScene("Sshape", obstacles, goal=(0.0, 0.0))


VARIANTS: Mapping[str, Variant] = MappingProxyType(
    {
        "fig1": Variant(FIGURE_1),
        "narrow_prior": Variant(FIGURE_1, smooth_std=1.0),
        "unequal_classes": Variant(_scene((0.0, 33.0, 3.0), (36.0, 10.0, 3.0))),
        "many_classes": Variant(
            _scene((14.0, 45.0, 2.5), (-2.0, 33.0, 2.5), (20.0, 21.0, 2.5), (38.0, 10.0, 2.5))
        ),
    }
)
"""By name: Fig. 1; with a third of the added deviation; one class nearly free; sixteen classes."""


@dataclass(frozen=True)
class Ground:
    """Reference of all settings in a variant.

    Attributes:
        variant: of it.
        primitive: its prior.
        prior: draws of the unadapted primitive, for similarity.
        runs: paths of each run of the reference.
        posterior: of all runs together.
    """

    variant: Variant
    primitive: SMP
    prior: FloatArray
    runs: tuple[FloatArray, ...]
    posterior: Reference

    @classmethod
    def of(cls, variant: Variant, runs: int, smc: SMCSettings | None = None) -> Ground:
        """Return the ground of a variant.

        Args:
            variant: to be measured in.
            runs: of the reference, at least 1.
            smc: of each.
        """
        primitive = learn(variant.scene.shape, variant.smooth_std)
        drawn = tuple(
            exact_draws(primitive, variant.scene, _ADAPT_SETTINGS, np.random.default_rng(run), smc)
            for run in range(runs)
        )
        paths = np.concatenate(drawn)
        signatures = classes(paths, variant.scene.obstacles, common_ends(primitive))
        prior = reference_of(primitive)
        return cls(variant, primitive, prior, drawn, Reference(paths, signatures))

    def row(self, setting: str, particles: int, seed: int) -> Row:
        """Return the row of one repetition of a setting.

        Args:
            setting: one of `inference.SETTINGS`, or `EXACT`.
            particles: P.
            seed: of the repetition.
        """
        if setting == EXACT:
            rng = np.random.default_rng([seed, 1])
            every = len(self.posterior.paths)
            paths = self.posterior.paths[rng.choice(every, particles, replace=False)]
        else:
            iterations = named_settings(setting).iterations
            run = adaptation("smp", inference=setting, iterations=iterations)
            method = Method(run, _ADAPT_SETTINGS)
            paths = adapted(
                self.primitive, self.variant.scene, method, particles, seed
            ).trajectories
        return {**self._compared(setting, paths, seed), **similarity(paths, self.prior)}

    def reference_rows(self) -> Iterator[Row]:
        """Yield a row of each run of the reference, without similarity, which depends on size."""
        for seed, paths in enumerate(self.runs):
            yield {**self._compared(POSTERIOR, paths, seed), **similarity(paths[:0], self.prior)}

    def _compared(self, setting: str, paths: FloatArray, seed: int) -> Row:
        scene = self.variant.scene
        signatures = classes(paths, scene.obstacles, common_ends(self.primitive))
        return {
            **posterior_row(setting, paths, signatures, self.posterior, scene),
            "seed": seed,
        }


def settings_rows(
    ground: Ground, settings: Sequence[str], particles: int, repetitions: int, title: str
) -> list[Row]:
    """Return the rows of the reference's runs, of draws from it, and of settings of SVGD.

    Args:
        ground: of a variant.
        settings: of `inference.SETTINGS`.
        particles: P of each set.
        repetitions: of each setting, with seeds from 0.
        title: of the progress bar.
    """
    todo = [(setting, seed) for setting in (EXACT, *settings) for seed in range(repetitions)]
    measured = (ground.row(setting, particles, seed) for setting, seed in track(todo, title))
    return [*ground.reference_rows(), *measured]


def settings_columns(ground: Ground) -> tuple[Column, ...]:
    """Return the columns of the printed table of a ground's rows."""
    setting, free, count, *others = columns(ground.posterior)
    similar = (
        Column("wasserstein", "W1, mm"),
        Column("frechet", "Fréchet, mm"),
        Column("mmd", "MMD", 3),
    )
    return (setting, free, count, *similar, *others)
