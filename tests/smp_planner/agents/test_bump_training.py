"""Policy search over bumps: its gradient, a bandit with a known optimum, tiny trainings, files."""

import itertools
import json
from dataclasses import asdict, replace

import numpy as np
import pytest
import torch
from shipped_planners import planners_of

from smp_gym.folder_lock import FolderInUseError
from smp_gym.sampling import place_without_witness, sample_scene
from smp_gym.scene import TASKS
from smp_gym.suites import Cell
from smp_planner.agents.bump_training import (
    FIRST_SEED,
    BumpSettings,
    BumpTraining,
    advantages,
    clipped_loss,
)
from smp_planner.agents.posed_scenes import posed
from smp_planner.agents.shipping import scores_of, ship_agent
from smp_planner.benchmark.episodes import EpisodeRow
from smp_planner.benchmark.manifest import EpisodeStore, make_manifest
from smp_planner.planners import make_planner
from smp_planner.planners.agent_file import AgentCard, read_agent, write_agent
from smp_planner.planners.bump_planner import LEARNED, BumpPlanner
from smp_planner.planners.bump_policy import ActionDistribution, BumpPolicy, Looks, NetworkShape
from smp_planner.planners.card_file import shipped_agent

TINY = BumpSettings(scenes=2, placed=1, batch=3, rollouts=4, epochs=2, bumps=2, annealing=3)


def distribution(choice, mean, log_std):
    return ActionDistribution(choice.log_softmax(-1), mean, log_std.exp())


def test_the_gradient_is_that_of_finite_differences():
    generator = torch.Generator().manual_seed(0)

    def normal(*shape):
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    parameters = [normal(2, 3), normal(2, 3, 4), 0.1 * normal(4)]
    component = torch.randint(3, (2, 5), generator=generator)
    action = normal(2, 5, 4)
    # Ratios on both sides of the clip, none of them at its edge.
    before = distribution(*parameters).log_prob(component, action) + 0.3 * normal(2, 5)
    advantage = normal(2, 5)

    def loss(*given):
        return clipped_loss(distribution(*given), component, action, before, advantage, 0.2)

    assert torch.autograd.gradcheck(loss, [p.requires_grad_() for p in parameters])
    ratio = (distribution(*parameters).log_prob(component, action) - before).exp()
    assert 0 < ((ratio - 1.0).abs() > 0.2).sum() < ratio.numel()


def test_log_densities_are_those_of_torch_s_distributions():
    policy = BumpPolicy(NetworkShape(4, 2, sees=False))
    torch.nn.init.normal_(policy.constant)
    blank = Looks(torch.zeros(1, 2, 72), torch.zeros(1, 2, 1, 45), torch.zeros(1, 1, dtype=bool))
    found = policy(blank)
    component, action = found.sample(3, torch.Generator().manual_seed(1))
    normal = torch.distributions.Normal(found.mean[0, component[0]], found.std)
    chosen = torch.distributions.Categorical(logits=found.choice[0]).log_prob(component[0])
    constant = 2.0 * np.log(2.0 * np.pi)
    torch.testing.assert_close(
        found.log_prob(component, action)[0] - constant,
        normal.log_prob(action[0]).sum(-1) + chosen,
    )


def test_the_learning_rate_falls_to_a_tenth_and_stays():
    settings = BumpSettings(learning_rate=0.02, annealing=10)
    rates = [settings.rate(iteration) for iteration in range(13)]
    assert rates[0] == pytest.approx(0.02)
    assert rates[5] == pytest.approx(0.011)
    assert rates[10:] == pytest.approx([0.002] * 3)
    assert (np.diff(rates[:11]) < 0.0).all()
    assert BumpSettings(learning_rate=0.02).rate(500) == 0.02


def follow(policy, looks, advantage_of, rate, iterations, epochs=1):
    """Let a policy follow the clipped gradient of advantages of what it draws."""
    optimiser = torch.optim.Adam(policy.parameters(), rate)
    generator = torch.Generator().manual_seed(0)
    for _ in range(iterations):
        with torch.no_grad():
            drawn = policy(looks)
            gaussian, action = drawn.sample(16, generator)
            before = drawn.log_prob(gaussian, action)
            advantage = advantage_of(gaussian, action)
        for _ in range(epochs):
            loss = clipped_loss(policy(looks), gaussian, action, before, advantage, 0.2)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()


def test_it_finds_the_optimum_of_a_bandit():
    """Of two arms the second is better by 1, and its best action is known."""
    policy = BumpPolicy(NetworkShape(2, 2, sees=False), std=0.3)
    target = torch.tensor([0.5, -0.8])
    blank = Looks(torch.zeros(8, 2, 72), torch.zeros(8, 2, 1, 45), torch.zeros(8, 1, dtype=bool))

    def advantage_of(component, action):
        reward = component - (action - target).square().sum(-1)
        return reward - reward.mean(1, keepdim=True)

    follow(policy, blank, advantage_of, 0.05, 60, epochs=3)
    found = policy(blank)
    assert found.choice[0, 1].exp() > 0.9
    torch.testing.assert_close(found.mean[0, 1], target, atol=0.1, rtol=0.0)


@pytest.mark.parametrize("best_of", [1, 2, 3, 7])
def test_the_advantage_is_what_an_action_adds_to_the_best_of_several(best_of):
    """By every choice of the others, one after the other; ties included."""
    reward = np.random.default_rng(0).normal(size=(3, 7)).round(1)
    expected = np.zeros_like(reward)
    for scene, action in np.ndindex(*reward.shape):
        others = np.delete(reward[scene], action)
        expected[scene, action] = np.mean(
            [
                max(reward[scene, action], *chosen) - max(chosen)
                for chosen in itertools.combinations(others, best_of - 1)
            ]
            if best_of > 1
            else reward[scene, action] - reward[scene].mean()
        )
    expected /= np.sqrt(np.square(expected).mean())
    np.testing.assert_allclose(advantages(reward, best_of), expected, rtol=1e-4, atol=1e-9)


@pytest.mark.parametrize(("best_of", "kept"), [(1, 1), (4, 2)])
def test_heads_stay_apart_where_the_best_of_several_counts(best_of, kept):
    """In half of the scenes, which look alike, one action is right, in the others another."""
    torch.manual_seed(0)
    policy = BumpPolicy(NetworkShape(1, 1, sees=False, heads=2), std=0.2)
    blank = Looks(torch.zeros(16, 1, 72), torch.zeros(16, 1, 1, 45), torch.zeros(16, 1, dtype=bool))
    # A little more often the first.
    right = torch.tensor([[1.0]] * 10 + [[-1.0]] * 6)[:, None]

    def advantage_of(_, action):
        reward = torch.exp(-2.0 * (action - right).square().sum(-1)).numpy()
        return torch.from_numpy(advantages(reward, best_of).astype(np.float32))

    follow(policy, blank, advantage_of, 0.03, 150)
    found = policy(blank)
    likely = found.mean[0, found.choice[0].exp() > 0.1, 0]
    near = {int(place) for place in (1, -1) if ((likely - place).abs() < 0.3).any()}
    assert len(near) == kept, (found.mean[0], found.choice[0].exp())


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Return a tiny training that was interrupted, and the folder of one that was not."""
    whole, halves = tmp_path_factory.mktemp("whole"), tmp_path_factory.mktemp("halves")
    arguments = {
        "agent": "mp_rl",
        "task": "Placement",
        "difficulties": ["easy"],
        "seed": 5,
        "settings": TINY,
    }
    first = BumpTraining(whole, **arguments)
    first.run(4, every=1)
    (halves / "scenes.jsonl").write_bytes((whole / "scenes.jsonl").read_bytes())
    begun = BumpTraining(halves, **arguments)
    begun.run(1, every=1)
    with pytest.raises(FolderInUseError, match="another process is writing to the folder"):
        BumpTraining(halves, **arguments)
    begun.close()
    second = BumpTraining(halves, **arguments)
    assert second.iteration == 1
    second.run(4, every=1)
    second.close()
    return second, whole, halves


def test_some_training_scenes_have_a_reference_trajectory_and_the_others_have_none(trained):
    training, _, _ = trained
    first = FIRST_SEED + 5 * 5000
    drawn = [sample_scene("Placement", "easy", seed) for seed in (first, first + 1)]
    assert training.scenes == (*drawn, place_without_witness("Placement", "easy", first + 2))


def test_a_training_goes_on_as_if_undisturbed(trained):
    _, whole, halves = trained
    for name in ("agent.safetensors", "run.json"):
        assert (whole / name).read_bytes() == (halves / name).read_bytes()
    curve = (halves / "curve.csv").read_text().splitlines()
    assert curve[0].startswith("iteration,trajectories,cpu_seconds,reward,clear")
    counts = [line.split(",")[:2] for line in curve[1:]]
    assert counts == [["1", "12"], ["2", "24"], ["3", "36"], ["4", "48"]]
    card = json.loads((halves / "agent.json").read_text())
    assert card["training"]["trajectories"] == 48
    assert card["training"]["cpu_seconds"] > 0.0
    with pytest.raises(ValueError, match="holds another training"):
        BumpTraining(
            halves, agent="detour", task="Placement", difficulties=["easy"], seed=5, settings=TINY
        )


def test_a_curve_that_a_kill_left_behind_its_checkpoint_is_completed(tmp_path):
    training = BumpTraining(
        tmp_path, agent="detour", task="Placement", difficulties=["easy"], seed=0, settings=TINY
    )
    training.run(2, every=1)
    training.close()
    curve = tmp_path / "curve.csv"
    whole = curve.read_text()
    curve.write_text("".join(whole.splitlines(keepends=True)[:-1]))
    again = BumpTraining(
        tmp_path, agent="detour", task="Placement", difficulties=["easy"], seed=0, settings=TINY
    )
    again.run(2, every=1)
    again.close()
    assert curve.read_text() == whole


def test_weights_of_another_card_are_refused(tmp_path):
    card = AgentCard("mp_rl", "Placement", 2, asdict(NetworkShape(12, 1)), {}, {})
    for name, seed in (("one", 0), ("other", 1)):
        torch.manual_seed(seed)
        write_agent(tmp_path / f"{name}.json", BumpPolicy(NetworkShape(12, 1)), card)
    read_agent(tmp_path / "one.json")
    # As a kill between the two files leaves them.
    (tmp_path / "one.safetensors").write_bytes((tmp_path / "other.safetensors").read_bytes())
    with pytest.raises(ValueError, match=r"one\.safetensors is not the weights of .*sha256"):
        read_agent(tmp_path / "one.json")


def test_the_agent_from_its_file_is_the_trained_one(trained):
    training, _, halves = trained
    problem = posed(training.scenes)[0]
    planner = make_planner(
        "mp_rl", "Placement", settings={"agent": str(halves / "agent.json"), "particles": 8}
    )
    assert isinstance(planner, BumpPlanner)
    (plan,) = planner.plan([problem])
    assert plan.trajectories.shape == (8, 200, 6)
    assert {"conditioning", "inference", "verification"} == set(plan.timings)
    # The first proposal is the mean action of the network in single precision, before its file.
    expected = training.mean_trajectory(problem)
    np.testing.assert_allclose(plan.trajectories[0], expected, atol=2e-3)
    assert np.abs(plan.trajectories[1:] - expected).max() > 0.1
    for constraint in problem.constraints:
        missed = constraint.missed(plan.trajectories)
        assert (missed <= constraint.slack(planner._plan_settings)).all()
    (again,) = planner.plan([problem])
    np.testing.assert_array_equal(again.trajectories, plan.trajectories)
    (other,) = planner.plan([replace(problem, seed=problem.seed + 1)])
    np.testing.assert_allclose(other.trajectories[0], plan.trajectories[0], atol=1e-12)
    assert np.abs(other.trajectories[1] - plan.trajectories[1]).max() > 0.01
    mean = make_planner(
        "mp_rl", "Placement", settings={"agent": str(halves / "agent.json"), "action": "mean"}
    )
    (alone,) = mean.plan([problem])
    np.testing.assert_allclose(alone.trajectories, plan.trajectories[:1], atol=1e-12)


def test_a_shipped_agent_acts_as_before_and_carries_its_scores(trained, tmp_path):
    _, _, halves = trained
    manifest = make_manifest([Cell("Placement", "easy")], ["promp"], 7, 2)
    manifest = replace(manifest, methods=("mp_rl",), specs={"mp_rl": "mp_rl"})
    results = tmp_path / "results"
    values = {"collision": False, "cause": "", "contact": "", "goal_error": 0.0}
    values |= {"path_length": 1.0, "clearance": 0.01, "steps": 9, "difficulty": "easy"}
    with EpisodeStore(results, manifest) as store:
        for seed, success in ((7, True), (8, False)):
            row = EpisodeRow(task="Placement", method="mp_rl", seed=seed, success=success, **values)
            store.append(row)
    path = ship_agent(halves / "agent.json", results, tmp_path)
    assert path == tmp_path / "mp_rl_Placement.json"
    trained_weights = (halves / "agent.safetensors").read_bytes()
    assert path.with_suffix(".safetensors").read_bytes() == trained_weights
    scores = read_agent(path)[1].scores["Placement_easy"]
    assert scores["seeds"] == [7, 8]
    # Wilson's interval of 1 of 2, from his formula.
    z = 1.959964
    half = z / (1 + z**2 / 2) * np.sqrt(0.25 / 2 + z**2 / 16)
    assert scores["mp_rl"]["count"] == 2
    assert scores["mp_rl"]["low"] == pytest.approx(0.5 - half, abs=1e-4)
    with pytest.raises(ValueError, match="must hold episodes of mp_rl on DrawS"):
        scores_of(results, "mp_rl", "DrawS")


def test_mp_rl_and_its_control_are_shipped_for_every_task():
    for task in TASKS:
        assert {"mp_rl", "detour"} <= set(planners_of(task))


@pytest.mark.parametrize(
    ("name", "task"), [(n, task) for task in TASKS for n in planners_of(task) if n in LEARNED]
)
def test_shipped_agents_are_small_and_say_what_they_are(name, task):
    path = shipped_agent(name, task)
    policy, card = read_agent(path)
    assert (card.agent, card.task) == (name, task)
    assert policy.shape.sees == (name != "detour")
    assert path.with_suffix(".safetensors").stat().st_size < 320_000
    for entry in ("seed", "iterations", "trajectories", "cpu_seconds"):
        assert card.training[entry] >= 0
    assert card.scores


def test_damaged_files_and_wrong_agents_are_refused(trained, tmp_path):
    training, _, halves = trained
    path = tmp_path / "agent.json"
    for name in ("agent.json", "agent.safetensors"):
        (tmp_path / name).write_bytes((halves / name).read_bytes())
    weights = path.with_suffix(".safetensors")
    with pytest.raises(ValueError, match="must be an agent mp_rl of DrawS"):
        make_planner("mp_rl", "DrawS", settings={"agent": str(path)})
    with pytest.raises(ValueError, match="must be an agent detour of Placement"):
        make_planner("detour", "Placement", settings={"agent": str(path)})
    with pytest.raises(ValueError, match="colour"):
        make_planner("mp_rl", "Placement", settings={"colour": 1})
    content = weights.read_bytes()
    weights.write_bytes(content[: len(content) // 2])
    with pytest.raises(ValueError, match=r"agent\.safetensors is not the weights"):
        read_agent(path)
    other = BumpPolicy(NetworkShape(6, 1))
    write_agent(tmp_path / "other.json", other, training.card({}))
    with pytest.raises(ValueError, match=r"other\.safetensors is not the weights"):
        read_agent(tmp_path / "other.json")
    path.write_text("{}")
    with pytest.raises(ValueError, match="must be the card of an agent"):
        read_agent(path)
    with pytest.raises(ValueError, match=r"needs an agent for Placement.*train_mp_rl\.py"):
        make_planner("mp_rl", "Placement", settings={"agent": str(tmp_path / "none.json")})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"*": {"rollouts": 1}}', "rollouts"),
        ('{"*": {"speed": 1}}', "speed"),
        ('{"*": {"reward": "luck"}}', "reward"),
        ('{"*": {"heads": 0}}', "heads"),
        ('{"*": {"rollouts": 4, "best_of": 5}}', "best_of must be at most rollouts, 4, got 5"),
        ("[]", "must hold settings by name"),
        ("{", "JSON"),
    ],
)
def test_bad_settings_are_named(tmp_path, text, message):
    path = tmp_path / "settings.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        BumpSettings.from_json(path, "mp_rl", "Placement")
