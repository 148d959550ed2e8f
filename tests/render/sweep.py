"""Many random cases against the NumPy reference: `python -m tests.render.sweep --draws 5000`."""

import argparse
from collections import Counter
from contextlib import ExitStack

import numpy as np

from msb.cl import open_device
from tests.cl.conftest import SELECTOR
from tests.reference.soups import METHODS
from tests.render.differential import difference
from tests.render.random_cases import STANDARD, draw_case

GROUPS = (*METHODS, STANDARD)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=200, help="cases of each method (default: 200)")
    parser.add_argument("--first", type=int, default=0, help="the first seed (default: 0)")
    parser.add_argument("--method", choices=GROUPS, action="append", help="only this one; repeatable")
    parser.add_argument("--explained", action="store_true", help="show what rounding explains, too")
    chosen = parser.parse_args()
    with ExitStack() as stack:
        devices = {s: stack.enter_context(open_device(SELECTOR, style=s)) for s in ("cpu", "gpu")}
        for method in chosen.method or GROUPS:
            totals: Counter[str] = Counter()
            qualities = []
            for seed in range(chosen.first, chosen.first + chosen.draws):
                case = draw_case(method, seed)
                try:
                    found = difference(case, devices[case.style])
                except Exception as error:
                    print(f"{case}: {type(error).__name__}: {error}", flush=True)
                    totals["raised"] += 1
                    continue
                totals += Counter(pixels=found.pixels)
                totals += Counter({f"{name} explained": count for name, count in found.explained.items()})
                totals += Counter({f"{name} off": count for name, count in found.off.items()})
                qualities.append(found.quality)
                if found.off or found.quality < 100 or (chosen.explained and found.explained):
                    print(
                        f"{case}: off {found.off}, explained {found.explained}, {found.quality:.0f} dB",
                        flush=True,
                    )
            print(
                f"{method}: {chosen.draws} draws, {dict(totals)}, least {min(qualities):.0f} dB,"
                f" 1 % below {np.quantile(qualities, 0.01, method='lower'):.0f} dB",
                flush=True,
            )


if __name__ == "__main__":
    main()
