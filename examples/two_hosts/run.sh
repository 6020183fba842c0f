#!/usr/bin/env bash
# Two hosts in one: network namespaces with a cable between them. A graph runs on the one, and a node of the other joins it.
# Needs the right to make namespaces: sudo examples/two_hosts/run.sh [FOLDER], from anywhere.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
out=${1:-$(mktemp -d)}
mkdir -p "$out"/{rig,laptop}/{keys,run}
chmod 700 "$out"/{rig,laptop}/{keys,run}
palp=${PALP:-palp}
rig=rig-$$ laptop=laptop-$$

ip netns add "$rig"
ip netns add "$laptop"
remove() { ip netns delete "$rig" || true; ip netns delete "$laptop" || true; }
trap remove EXIT
ip link add "r$$" type veth peer name "l$$"
ip link set "r$$" netns "$rig" && ip link set "l$$" netns "$laptop"
ip -n "$rig" address add 10.213.8.1/24 dev "r$$" && ip -n "$rig" link set "r$$" up && ip -n "$rig" link set lo up
ip -n "$laptop" address add 10.213.8.2/24 dev "l$$" && ip -n "$laptop" link set "l$$" up && ip -n "$laptop" link set lo up

# Each host has its own keys and its own run directory; nothing of a disk is shared, but for the two public keys.
at_rig=(ip netns exec "$rig" env PALP_KEYS="$out/rig/keys" XDG_RUNTIME_DIR="$out/rig/run")
at_laptop=(ip netns exec "$laptop" env PALP_KEYS="$out/laptop/keys" XDG_RUNTIME_DIR="$out/laptop/run")

"${at_rig[@]}" "$palp" keys generate --name rig
"${at_laptop[@]}" "$palp" keys generate --name laptop
"${at_rig[@]}" "$palp" keys allow "$out/laptop/keys/laptop.public"

cd "$here/../chain"
"${at_rig[@]}" "$palp" launch launch/chain.yaml clock:=wall count:=1000000 --listen tcp://10.213.8.1:7600 >"$out/rig/said" 2>&1 &
launched=$!
until "${at_rig[@]}" "$palp" topic list 2>/dev/null | grep -q amplified; do kill -0 "$launched" || { cat "$out/rig/said"; exit 1; }; done

"${at_laptop[@]}" "$palp" run ../two_hosts/listener.py:Listener -r sample:=/relay/amplified -p blocks:=200 -p "out:=$out/heard.json" \
    --join tcp://10.213.8.1:7600 --server-key "$out/rig/keys/rig.public"
kill "$launched" && wait "$launched" || true
python3 - "$out/heard.json" <<'PYTHON'
import json
import sys

blocks = json.load(open(sys.argv[1]))
missing = blocks[-1] + 1 - blocks[0] - len(blocks)
print(f"the laptop joined at block {blocks[0]}, and heard {len(blocks)}; missing: {missing} ({sys.argv[1]})")
PYTHON
