#!/usr/bin/env bash
# A graph, and clients that know only ZeroMQ and msgpack: they read a topic, put a load on the sensor, and tare it.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
XDG_RUNTIME_DIR=$(mktemp -d)
export XDG_RUNTIME_DIR
palp=${PALP:-palp} python=${PYTHON:-python3}

"$palp" launch "$here/launch/interop.yaml" >"$XDG_RUNTIME_DIR/said" 2>&1 &
launched=$!
trap 'kill "$launched" 2>/dev/null; wait "$launched" || true; rm -r "$XDG_RUNTIME_DIR"' EXIT
until "$palp" topic echo /sensor/torque --once >"$XDG_RUNTIME_DIR/first" 2>&1; do
    kill -0 "$launched" || { cat "$XDG_RUNTIME_DIR/said"; exit 1; }
done
graph=$(echo "$XDG_RUNTIME_DIR"/palp/*/graph.json) # docs/reference/wire.md: where a graph is

for client in "$python $here/python/%s.py" "node $here/node/%s.mjs"; do
    [ "${client%% *}" != node ] || { command -v node && [ -d "$here/node/node_modules" ]; } >/dev/null || continue # npm install
    call() { local script=$1; shift; ${client//%s/$script} "$graph" "$@"; }
    call publish /sensor/load '{"torque_n_m": 0.2}'
    call read_topic /sensor/torque 2
    call call_service /sensor/tare '{}'
    call read_topic /sensor/torque 1
done
