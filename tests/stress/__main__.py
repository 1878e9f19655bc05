"""``python -m tests.stress soak|attack|flood``: campaigns that anybody can repeat from a seed."""

import argparse

from tests.stress.attack import ATTACKS, attack
from tests.stress.flood import KINDS, floods
from tests.stress.soak import soak


def main(words: list[str] | None = None) -> int:
    """Run a campaign; 1 if there is something to complain about."""
    parser = argparse.ArgumentParser(prog="python -m tests.stress", description=__doc__)
    campaigns = parser.add_subparsers(dest="campaign", required=True)
    long = campaigns.add_parser("soak", help="a live page for a long time")
    long.add_argument("--minutes", type=float, default=60.0, help="how long [default: 60]")
    long.add_argument("--seed", type=int, default=1, help="what clients do [default: 1]")
    hostile = campaigns.add_parser("attack", help="all random attacks")
    hostile.add_argument("--seed", type=int, default=1, help="which ones [default: 1]")
    hostile.add_argument("--count", type=int, default=50, help="flights of each kind [default: 50]")
    hostile.add_argument("--only", choices=ATTACKS, nargs="*", help="only these kinds")
    flooded = campaigns.add_parser("flood", help="stops of a dashboard that other clients flood")
    flooded.add_argument("--clients", type=int, default=60, help="how many [default: 60]")
    flooded.add_argument("--seconds", type=float, default=8.0, help="how long each kind [default: 8]")
    flooded.add_argument("--only", choices=KINDS, nargs="*", help="only these kinds")
    options = parser.parse_args(words)
    if options.campaign == "flood":
        kinds = tuple(options.only or KINDS)
        return floods(options.clients, options.seconds, kinds, lambda line: print(line, flush=True))
    if options.campaign == "attack" and options.count < 1:
        parser.error(f"--count is {options.count}; give 1 or more")
    print(f"seed {options.seed}", flush=True)
    if options.campaign == "soak":
        result = soak(options.minutes, options.seed, lambda line: print(line, flush=True))
        print("\n".join((*result.complaints, *result.table())))
        return int(bool(result.complaints) or not result.good)
    table, complaints = attack(
        options.seed, options.count, options.only, lambda line: print(line, flush=True)
    )
    print("\n".join(table))
    return int(complaints > 0)


if __name__ == "__main__":
    raise SystemExit(main())
