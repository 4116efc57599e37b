#!/usr/bin/env bash
# Serves a database (that of the demo) on a free port of this machine, and lets the reference client compare the surface that it
# rebuilds with the server's heights.
#
#   tools/meet_reference.sh PYTHON [DB [PROGRAM]]        PYTHON has grpcio, grpcio-tools and numpy
set -euo pipefail
cd "$(dirname "$0")/.."
python=${1:?name a Python with grpcio, grpcio-tools and numpy}
db=${2:-target/demo/helens}
program=${3:-target/release/terraquilt}

log=$(mktemp)
"$program" serve "$db" --listen 127.0.0.1:0 2>"$log" &
server=$!
trap 'kill $server 2>/dev/null || true; wait $server 2>/dev/null || true; rm -f "$log"' EXIT
for _ in $(seq 100); do
  address=$(sed -n 's|.*listens on http://\([0-9.:]*\).*|\1|p' "$log")
  [ -n "$address" ] && break
  kill -0 $server 2>/dev/null || { cat "$log" >&2; exit 1; }
  sleep 0.1
done
"$python" tools/reference_client.py "$address"
