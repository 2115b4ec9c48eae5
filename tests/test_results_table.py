"""The tables of README and results are counted from the rows that are shipped."""

import re
from collections import Counter, defaultdict

import pytest
from printed_tables import TASKS, lines_of, page, shipped

from smp_planner.benchmark.markdown_table import markdown_table
from smp_planner.benchmark.summary import rate_interval
from smp_planner.experiments.suite_summary import (
    cell_table,
    equal_episodes,
    method_table,
    pair_table,
)
from smp_planner.planners.agent_file import read_agent
from smp_planner.planners.card_file import shipped_agent

CELL = re.compile(r"(\d+) \((\d+)–(\d+)\) · (\d+|–)")


@pytest.fixture(scope="module")
def rows():
    return shipped("standard.csv.gz")


@pytest.fixture(scope="module")
def equal(rows):
    """Rows of the episodes that all methods have played, by episode and method."""
    episodes = defaultdict(dict)
    for row in rows:
        key = row["task"], row["difficulty"], row["half"], row["seed"]
        episodes[key][row["method"]] = row
    most = max(map(len, episodes.values()))
    return [found for found in episodes.values() if len(found) == most]


def printed(name, heading):
    """Return the cells of a table below its heading, by the first entry of each line."""
    return {
        entry.split("`")[1] if "`" in entry else entry: [
            tuple(None if part == "–" else int(part) for part in CELL.fullmatch(cell).groups())
            for cell in cells
        ]
        for entry, *cells in lines_of(name, heading)
        if "---" not in entry
    }


def counted(chosen):
    successes, count = sum(int(row["success"]) for row in chosen), len(chosen)
    interval = rate_interval(successes, count)
    good = [float(row["share_good"]) for row in chosen if row["share_good"]]
    assert len(good) in (0, count)
    rates = (round(100 * rate) for rate in (successes / count, interval["low"], interval["high"]))
    return *rates, round(100 * sum(good) / count) if good else None


@pytest.mark.parametrize("name", ["README.md", "docs/results.md"])
def test_methods_are_compared_on_equal_episodes(name, equal):
    table = printed(name, "| success · good | " + " | ".join(TASKS) + " |\n")
    assert len(equal) == 1200
    assert set(table) == set(equal[0])
    for method, cells in table.items():
        for task, cell in zip(TASKS, cells, strict=True):
            own = [found[method] for found in equal if found[method]["task"] == task]
            assert cell == counted(own), (method, task)


def test_the_command_prints_what_stands_there(rows, equal):
    episodes = equal_episodes(rows)
    assert episodes == equal
    pages = page("README.md"), page("docs/results.md")
    for line in markdown_table(method_table(episodes)).splitlines()[2:]:
        name = line.split(" |")[0]
        assert all(f"{line[len(name) :]}\n" in text for text in pages)
    for line in markdown_table(pair_table(episodes, "smp")).splitlines()[2:]:
        assert f"{line}\n" in pages[1]
    for line in markdown_table(cell_table(rows, "smp")).splitlines()[2:]:
        assert f"{line}\n" in pages[1]
    own = next(row for row in rows if row["method"] == "smp")
    with pytest.raises(ValueError, match=r"in common, \['promp', 'smp'\] have none"):
        equal_episodes([{**own, "method": "promp", "seed": "1"}, own])


def test_cells_of_smp_are_whole(rows):
    table = printed("docs/results.md", "| success · good | easy | medium | hard |\n")
    assert tuple(table) == TASKS
    for task, cells in table.items():
        for difficulty, cell in zip(("easy", "medium", "hard"), cells, strict=True):
            own = [
                row
                for row in rows
                if (row["method"], row["task"], row["difficulty"]) == ("smp", task, difficulty)
            ]
            assert len(own) == 100
            assert cell == counted(own)


@pytest.mark.parametrize(
    "rival",
    ["cpromp", "rrt_connect", "prompt_o", "promp_diff", "mp_rl", "detour", "promp", "distilled"],
)
def test_pairs_are_counted(rival, equal):
    lines = page("docs/results.md").splitlines()
    line = next(line for line in lines if line.startswith(f"| `{rival}` |") and " : " in line)
    pairs = [tuple(map(int, pair)) for pair in re.findall(r"(\d+) : (\d+)", line)]
    for task, pair in zip((*TASKS, None), pairs, strict=True):
        own = [
            (int(found["smp"]["success"]), int(found[rival]["success"]))
            for found in equal
            if task in (found["smp"]["task"], None)
        ]
        assert pair == (own.count((1, 0)), own.count((0, 1)))


def test_the_suite_tight_is_counted_by_family():
    episodes, text = equal_episodes(shipped("tight.csv.gz")), page("docs/results.md")
    lists = Counter(
        tuple(found["smp"][name] for name in ("task", "family", "difficulty")) for found in episodes
    )
    assert len(lists) == 30
    played = " or ".join(str(count) for count in sorted(set(lists.values())))
    assert f"the first {played} episodes of each list, {len(episodes)} in all" in text
    for table in (method_table(episodes, "family"), pair_table(episodes, "smp", "family")):
        for line in markdown_table(table).splitlines()[2:]:
            assert f"{line}\n" in text


def test_what_is_said_of_agents_of_before_on_the_suite_tight_is_counted():
    old, new = (
        {
            tuple(row[name] for name in ("task", "family", "difficulty", "seed")): int(
                row["success"]
            )
            for row in shipped(name)
            if row["method"] == "mp_rl"
        }
        for name in ("tight_fd467cd.csv.gz", "tight.csv.gz")
    )
    text = " ".join(page("docs/results.md").split())
    sides = sum(won for (task, *_), won in old.items() if task == "DoubleSidedPlacement")
    told = (
        f"solved {sum(old.values())} of these {len(new)} episodes, {sides} of them on DoubleSided"
    )
    assert told in text
    pairs = [(old[key], new[key]) for key in new]
    assert f"lose {pairs.count((1, 0))} of them and win {pairs.count((0, 1))}" in text
    assert f"and `mp_rl` {sum(new.values())} (" in text


def test_what_is_said_of_older_code_is_counted(rows):
    outcomes = {"old": _won(shipped("standard_5a6c30d.csv.gz")), "new": _won(rows)}
    text = " ".join(page("docs/results.md").split())
    old, new = (
        {key[1:]: won for key, won in outcomes[name].items() if key[0] == "smp"}
        for name in ("old", "new")
    )
    assert set(old) == set(new)
    assert f"at commit 5a6c30d, `smp` succeeded in {sum(old.values())}" in text
    pairs = [(old[key], new[key]) for key in old]
    alone = f"{pairs.count((1, 0))} episodes were solved then alone, {pairs.count((0, 1))} now"
    assert alone in text
    assert f"That is {sum(new.values())} of 1200" in text
    told = {
        "cpromp": "1 : 5",
        "promp_diff": "11 : 2",
        "prompt_o": "1 : 4",
        "rrt_connect": "3 : 12",
        "promp": "none",
        "detour": "7 : 81",
        "mp_rl": "24 : 96",
    }
    for method, said in told.items():
        pairs = [
            (won, outcomes["new"][key])
            for key, won in outcomes["old"].items()
            if key[0] == method and key in outcomes["new"]
        ]
        alone = f"{pairs.count((1, 0))} : {pairs.count((0, 1))}"
        assert alone == said.replace("none", "0 : 0")
        assert f"of `{method}` {said}" in text


def test_what_is_said_of_plans_by_the_recorded_stroke_is_counted(rows):
    _, _, gained, lost = _changes("draw_s_32ea3d6.csv.gz", _won(rows))
    alone = {method: [gained[method], lost[method]] for method in gained}
    text = " ".join(page("docs/results.md").split())
    own = dict(alone)
    assert own.pop("smp") == [3, 1]
    assert own.pop("cpromp") == [7, 1]
    assert own.pop("rrt_connect") == [9, 0]
    assert own.pop("prompt_o") == [8, 6]
    assert own.pop("promp_diff") == [0, 1]
    # These have other agents and further tries since.
    del own["mp_rl"], own["detour"]
    assert not any(map(any, own.values()))
    assert "`smp` now solves 3 that it did not and 1 not that it did, `cpromp` 7 and 1" in text


def test_what_is_said_of_the_second_search_and_of_further_tries_is_counted(rows):
    more_tries = _won(shipped("learned_fd467cd.csv.gz"))
    before, after, gained, lost = _changes("standard_dbcbc15.csv.gz", _won(rows) | more_tries)
    text = " ".join(page("docs/results.md").split())
    assert f"`smp` now solves {gained['smp']} that it did not and {lost['smp']} not" in text
    assert f"`cpromp` {gained['cpromp']} and {lost['cpromp']}, and `rrt_connect`" in text
    assert f"helped most, {gained['rrt_connect']} and {lost['rrt_connect']} (" in text
    assert lost["mp_rl"] == lost["detour"] == 0
    assert f"`mp_rl` solved {after['mp_rl']} episodes where it had solved {before['mp_rl']}" in text
    assert f"and `detour` {after['detour']} where it had solved {before['detour']}" in text


def test_what_is_said_of_agents_that_were_trained_anew_is_counted(rows):
    text = " ".join(page("docs/results.md").split())
    _, after, gained, lost = _changes("learned_fd467cd.csv.gz", _won(rows))
    for method in ("mp_rl", "detour"):
        told = f"`{method}` {after[method]} ({gained[method]} won, {lost[method]} lost)"
        assert told in text
        before = _placed(shipped("learned_fd467cd.csv.gz"), method)
        now = _placed(rows, method)
        assert f"`{method}` {now} of 600 where it had solved {before}" in text


HALVES = {"with a reference trajectory": "witness", "placed without": "placed"}


def test_what_agents_reach_is_counted_by_halves(equal):
    text = " ".join(page("docs/agents.md").split())
    heading, *lines = lines_of("docs/agents.md", "## What `mp_rl` reaches")
    told = {line[0]: line[1:] for line in lines if "`, " in line[0]}
    by_half = {half: [e for e in equal if e["smp"]["half"] == half] for half in HALVES.values()}
    for said, half in HALVES.items():
        for method in ("smp", "mp_rl", "detour"):
            for task, cell in zip(heading[1:], told.pop(f"`{method}`, {said}"), strict=True):
                own = [e[method] for e in by_half[half] if e[method]["task"] == task]
                assert len(own) == 150
                assert cell == "{} ({}–{})".format(*counted(own)[:3])
    for said, entry in (
        ("CPU seconds of training", "cpu_seconds"),
        ("trajectories checked", "trajectories"),
    ):
        for task, cell in zip(heading[1:], told.pop(f"{said}: `mp_rl`, `detour`"), strict=True):
            cards = [read_agent(shipped_agent(name, task))[1] for name in ("mp_rl", "detour")]
            spent = (f"{card.training[entry]:,.0f}".replace(",", " ") for card in cards)
            assert cell.replace(" ", "") == ", ".join(spent).replace(" ", "")
    assert not told
    for half, first, second, sentence in (
        ("witness", "mp_rl", "detour", "to see the scene is worth {} episodes"),
        ("witness", "smp", "mp_rl", "what `mp_rl` leaves, {}."),
        ("placed", "smp", "mp_rl", "`smp` alone solves {}."),
    ):
        pairs = [(e[first]["success"], e[second]["success"]) for e in by_half[half]]
        assert sentence.format(f"{pairs.count(('1', '0'))} : {pairs.count(('0', '1'))}") in text


def _placed(rows, method):
    """Return how many episodes without a reference trajectory a method solves."""
    return sum(int(r["success"]) for r in rows if (r["method"], r["half"]) == (method, "placed"))


def _won(rows):
    """Return whether each episode was a success."""
    return {_episode(row): int(row["success"]) for row in rows}


def _changes(name, now):
    """Return successes by method in a file and now, and how many were won and lost."""
    before, after, gained, lost = Counter(), Counter(), Counter(), Counter()
    for row in shipped(name):
        old, new = int(row["success"]), now[_episode(row)]
        before[row["method"]] += old
        after[row["method"]] += new
        gained[row["method"]] += new > old
        lost[row["method"]] += new < old
    return before, after, gained, lost


def _episode(row):
    return tuple(row[name] for name in ("method", "task", "difficulty", "half", "seed"))


SPEEDS = {"easy": "5 cm/s", "medium": "10 cm/s", "hard": "20 cm/s"}


def test_planning_anew_is_held_against_planning_once():
    lines = page("docs/results.md").splitlines()
    played = defaultdict(dict)
    for row in shipped("dynamic.csv.gz"):
        displaced = row["family"] == "displaced"
        cell = f"{row['task']}, {'displaced' if displaced else SPEEDS[row['difficulty']]}"
        episode = row["difficulty"], row["half"], row["seed"]
        played[cell].setdefault(episode, {})[row["run"]] = int(row["success"])
    assert len(played) == 8
    for cell, episodes in played.items():
        (line,) = (line for line in lines if line.startswith(f"| {cell}"))
        pairs = [(found["once"], found["anew"]) for found in episodes.values()]
        assert len(pairs) == (90 if cell.endswith("displaced") else 30)
        rates = []
        for successes in (sum(once for once, _ in pairs), sum(anew for _, anew in pairs)):
            interval = rate_interval(successes, len(pairs))
            shares = successes / len(pairs), interval["low"], interval["high"]
            rates.append(tuple(round(100 * share) for share in shares))
        found = re.findall(r"(\d+) \((\d+)–(\d+)\)", line)
        assert [tuple(map(int, numbers)) for numbers in found] == rates
        assert f"| {pairs.count((1, 0))} : {pairs.count((0, 1))} |" in line


SEEN = {"1 cm": "0.01", "2 cm": "0.02", "3 cm": "0.03", "depth camera": "0.0"}


@pytest.mark.parametrize("name", SEEN)
def test_planning_anew_is_held_against_planning_once_where_looks_err(name):
    played = defaultdict(dict)
    for row in shipped("perception.csv.gz"):
        if row["noise"] == SEEN[name]:
            episode = row["task"], row["half"], row["seed"]
            played[episode][row["run"]] = int(row["success"])
    pairs = [(found["once"], found["anew"]) for found in played.values()]
    (cells,) = (
        cells
        for entry, *cells in lines_of("docs/results.md", "The suite `perception`")
        if entry == name
    )
    rates = []
    for successes in (sum(once for once, _ in pairs), sum(anew for _, anew in pairs)):
        interval = rate_interval(successes, len(pairs))
        shares = successes / len(pairs), interval["low"], interval["high"]
        rates.append("{} ({}–{})".format(*(round(100 * share) for share in shares)))
    alone = f"{pairs.count((1, 0))} : {pairs.count((0, 1))}"
    assert cells == [str(len(pairs)), *rates, alone]
