#!/usr/bin/env python3
"""Counts the instructions of a command under callgrind and prints where they go.

    apt install valgrind
    python3 tools/count_instructions.py [--top 12] -- target/release/examples/speed pyramid DB

Instruction counts do not depend on what else the machine does: two builds can be compared on a busy one. Threads are set to one
(RAYON_NUM_THREADS), the program runs some fifty times slower, and valgrind knows no AVX-512: the code for smaller registers is
counted. Names are shortened to the last three parts of a path; a function comes once for
each file that it was inlined from. Memory that is cleared by `rep stos` counts an instruction a byte.
"""
import argparse, os, re, subprocess, sys, tempfile

LINE = re.compile(r"^\s*([\d,]+) \(\s*([\d.]+)%\)\s+(.*)$")


def short(place):
    """`file:function [object]` without generics, hashes and folders."""
    name = re.sub(r"\s*\[.*?\]$", "", place)
    name = name.split(":", 1)[1] if ":" in name and "/" in name.split(":", 1)[0] or name.startswith("???:") else name
    name = re.sub(r"::h[0-9a-f]{16}", "", name)
    while re.search(r"<[^<>]*>", name):
        name = re.sub(r"<([^<>]*)>", lambda m: m.group(1).split(" as ")[0].split("::")[-1] if " as " in m.group(1) else "", name)
    return "::".join([p for p in name.split("::") if p][-3:])


def main():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ap.add_argument("--top", type=int, default=12)
    ap.add_argument("--part", action="append", help="count only while this function runs (its name, * allowed); may be given again")
    ap.add_argument("command", nargs="+")
    a = ap.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        out = os.path.join(folder, "callgrind.out")
        only = [f"--toggle-collect={p}" for p in a.part or []]
        run = subprocess.run(["valgrind", "--tool=callgrind", f"--callgrind-out-file={out}", *only, *a.command],
                             env={**os.environ, "RAYON_NUM_THREADS": "1"}, capture_output=True, text=True)
        if run.returncode != 0:
            sys.exit(run.stderr[-2000:])
        text = subprocess.run(["callgrind_annotate", "--threshold=99", out], capture_output=True, text=True, check=True).stdout
    shown = 0
    for line in text.splitlines():
        m = LINE.match(line)
        if not m:
            continue
        if "PROGRAM TOTALS" in m.group(3):
            print(f"{m.group(1):>20}  100.0 %  all")
        elif shown < a.top:
            print(f"{m.group(1):>20}  {float(m.group(2)):5.1f} %  {short(m.group(3))}")
            shown += 1


if __name__ == "__main__":
    main()
