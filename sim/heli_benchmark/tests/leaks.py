"""Can a classifier guess the truth from names, lengths, number formats and headers of a split's files?

``python -m heli_benchmark.tests.leaks DIR [TRUTHS]`` prints the answer for a split. The classifier is naive
Bayes over the distinct values of each feature, judged on cases that it was not trained on. The truth is
permuted to find how well it does by chance.
"""

import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from heli_benchmark.task import Split, read_split

Features = Mapping[str, object]
PERMUTATIONS = 200


def file_features(folder: Path) -> dict[str, object]:
    """Features of the files of a case other than their numbers."""
    features: dict[str, object] = {"number": int(folder.name.partition("-")[2]) % 4}
    names = sorted(path.name for path in folder.iterdir())
    features["names"] = tuple(names)
    for path in sorted(folder.glob("*.csv")):
        lines = path.read_text().splitlines()
        decimals = {tuple(len(cell.partition(".")[2]) for cell in line.split(",")) for line in lines[1:]}
        features |= {f"{path.name} header": lines[0], f"{path.name} decimals": tuple(sorted(decimals))}
        features |= {f"{path.name} rows": len(lines), f"{path.name} step": lines[2].partition(",")[0]}
        features[f"{path.name} bytes per row"] = round(path.stat().st_size / len(lines))
    for path in sorted(folder.glob("*.parquet")):
        import pyarrow.parquet

        schema = pyarrow.parquet.read_schema(path)
        features[f"{path.name} schema"] = str(schema)
        features[f"{path.name} notes"] = str(schema.metadata)
    rig = (folder / "rig.toml").read_text()
    features["decimals of the rig"] = tuple(
        sorted({len(decimals) for decimals in re.findall(r"\.(\d+)", rig)})
    )[:1]
    return features


def accuracy(features: Sequence[Features], labels: Sequence[bool]) -> float:
    """Share of the cases that naive Bayes guesses, each left out of its training."""
    keys = sorted({key for case_features in features for key in case_features})
    right = 0
    for i, case_features in enumerate(features):
        rest = [k for k in range(len(features)) if k != i]
        score = {}
        for label in (False, True):
            same = [k for k in rest if labels[k] == label]
            score[label] = np.log((len(same) + 1.0) / (len(rest) + 2.0))
            for key in keys:
                hits = sum(features[k].get(key) == case_features.get(key) for k in same)
                score[label] += np.log((hits + 0.5) / (len(same) + 1.0))
        right += (score[True] > score[False]) == labels[i]
    return right / len(features)


def chance(features: Sequence[Features], labels: Sequence[bool], permutations: int = PERMUTATIONS) -> float:
    """Share of permuted truths that the classifier guesses at least as well as the real one."""
    rng = np.random.default_rng(0)
    reached = accuracy(features, labels)
    by_chance = [accuracy(features, list(rng.permutation(labels))) for _ in range(permutations)]
    return float(np.mean([score >= reached for score in by_chance]))


def labels_of(split: Split) -> list[bool]:
    """Whether something is hidden in each case."""
    truths = [split.truth(case.name) for case in split.cases]
    return [bool(truth["causes"] or truth["unlisted"]) for truth in truths]


def main(folder: Path, truths: Path | None = None) -> int:
    """Print the accuracy of the classifier, and how often chance reaches it."""
    split = read_split(folder, truths)
    features, labels = [file_features(case) for case in split.cases], labels_of(split)
    majority = max(np.mean(labels), 1.0 - np.mean(labels))
    print(f"{len(labels)} cases; always the more frequent answer: {majority:.0%} right")
    print(f"classifier: {accuracy(features, labels):.0%} right; ", end="")
    print(f"by chance as good or better: {chance(features, labels):.0%} of {PERMUTATIONS} permutations")
    return 0


if __name__ == "__main__":
    sys.exit(main(*map(Path, sys.argv[1:])))
