"""How many lies are noticed, and what poses come of the others: counts and tables."""

from .tellings import LIES, TRUE

SURE, UNSURE = 0.9, 0.5  # confidence above and below


def key_of(line: dict) -> tuple:
    """What tells a line from all others; its first three say which group it is of."""
    return tuple(line[key] for key in ("set", "views", "group", "lie", "variant"))


def counts(lines: list[dict]) -> dict:
    """What some lies amount to; of poses that are wrong, how many are doubted, and how many sure:
    not warned of, and of a confidence above 0.9."""
    poses = [(pose, bool(line["warnings"])) for line in lines for pose in line["poses"]]
    wrong = [(pose["confidence"], warned) for pose, warned in poses if not pose["right"]]
    doubted = [warned or (sure is not None and sure < UNSURE) for sure, warned in wrong]
    sure = [not warned and sure is not None and sure > SURE for sure, warned in wrong]
    noticed = sum(bool(line["refused"] or line["warnings"]) for line in lines)
    unconfirmed = sum(line.get("unconfirmed", 0) for line in lines)
    compared = unconfirmed + sum(line.get("confirmed", 0) for line in lines)
    codes = sorted({code for line in lines for code in line["warnings"]})
    return {
        "groups": len({key_of(line)[:3] for line in lines}),
        "told": len(lines),
        "refused": sum(line["refused"] is not None for line in lines),
        "codes": {code: sum(code in line["warnings"] for line in lines) for code in codes},
        "noticed": _share(noticed, len(lines)),
        "compared": compared,
        "unconfirmed": _share(unconfirmed, compared),
        "poses": len(poses),
        "wrong": len(wrong),
        "doubted": _share(sum(doubted), len(wrong)),
        "sure_wrong": sum(sure),
        "sure_wrong_share": _share(sum(sure), len(poses)),
    }


def _share(count: int, total: int) -> float | None:
    return count / total if total else None


def summary(lines: list[dict]) -> dict:
    """`lies` by name, each with its kind; `kinds`; and `all` lies, true groups left out."""
    names = dict.fromkeys((line["kind"], line["lie"]) for line in lines)
    places = {kind: place for place, kind in enumerate(LIES)}
    names = sorted(names, key=lambda pair: places[pair[0]])

    def of(**wanted: str) -> dict:
        return counts([x for x in lines if all(x[k] == v for k, v in wanted.items())])

    return {
        "lies": {name: {"kind": kind} | of(kind=kind, lie=name) for kind, name in names},
        "kinds": {kind: of(kind=kind) for kind in dict.fromkeys(kind for kind, _ in names)},
        "all": counts([line for line in lines if line["kind"] != TRUE]),
    }


HEAD = ["", "groups", "told", "refused", "noticed", "poses", "wrong", "of these doubted"]
HEAD += ["wrong and sure", "of all poses"]


def table(told: dict) -> str:
    """Markdown of a summary."""

    def percent(share: float | None, digits: int = 0) -> str:
        return "–" if share is None else f"{100 * share:.{digits}f} %"

    def row(name: str, one: dict) -> list:
        return [
            name, one["groups"], one["told"], one["refused"], percent(one["noticed"]), one["poses"],
            one["wrong"], percent(one["doubted"]), one["sure_wrong"],
            percent(one["sure_wrong_share"], 1),
        ]  # fmt: skip

    rows = [HEAD, ["---"] * len(HEAD)]
    for kind, whole in told["kinds"].items():
        rows += [row(name, one) for name, one in told["lies"].items() if one["kind"] == kind]
        if kind != TRUE:
            rows.append(row(f"**all {kind}**", whole))
    if told["all"]["told"]:
        rows.append(row("**all lies**", told["all"]))
    return "".join("| " + " | ".join(str(cell) for cell in row) + " |\n" for row in rows)


def totals(told: dict) -> str:
    """The figures that count most, in a line each."""
    every, true = told["all"], told["kinds"].get(TRUE)
    text = ""
    if every["poses"]:
        share = 100 * every["sure_wrong_share"]
        text += f"wrong, not warned of, above {SURE}: {share:.2f} % of {every['poses']} poses "
        text += "under lies\n"
    if true:
        text += f"false alarms: {100 * true['noticed']:.2f} % of {true['told']} true groups\n"
    for kind, one in told["kinds"].items():
        if one["unconfirmed"] is not None:
            text += f"unconfirmed by the other camera, {kind}: {100 * one['unconfirmed']:.1f} % of "
            text += f"{one['compared']} objects\n"
    return text


def faults(told: dict, bounds: dict[str, float | None]) -> list[str]:
    """A sentence for each bound that is not kept.

    - bounds: shares by name, as the options have them; None: not asked for
    """
    kinds, every = told["kinds"], told["all"]
    values = {
        "most_sure_wrong": (every["sure_wrong_share"] or 0.0) if every["told"] else None,
        "most_false_alarms": kinds[TRUE]["noticed"] if TRUE in kinds else None,
        "least_noticed_gross": kinds["gross"]["noticed"] if "gross" in kinds else None,
        "least_noticed_fine": kinds["fine"]["noticed"] if "fine" in kinds else None,
    }
    sentences = []
    for name, bound in bounds.items():
        value, most = values[name], name.startswith("most")
        if bound is None:
            continue
        option = f"--{name.replace('_', '-')}"
        if value is None:
            sentences.append(f"{option}: expected what it is of, got none; fix: run it with --kind")
        elif value > bound if most else value < bound:
            word = "most" if most else "least"
            sentences.append(f"{option}: expected {bound:g} at {word}, got {value:.4f}")
    return sentences
