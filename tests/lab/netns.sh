#!/usr/bin/env bash
# Networks of the lab, on this machine and apart from its own: TAG-cell with a link to TAG-left (10.77.1.0/24)
# and one to TAG-right (10.77.2.0/24), MTU 9000.  netns.sh up TAG | netns.sh down TAG      (root)
set -euo pipefail
what=$1 tag=$2

down() {
  for place in cell left right; do ip netns del "$tag-$place" 2>/dev/null || true; done
}

case $what in
  up)
    trap down ERR
    for place in cell left right; do
      ip netns add "$tag-$place"
      ip -n "$tag-$place" link set lo up
    done
    number=1
    for place in left right; do
      ip link add "eye$number" netns "$tag-cell" type veth peer name cable netns "$tag-$place"
      ip -n "$tag-cell" addr add "10.77.$number.1/24" dev "eye$number"
      ip -n "$tag-$place" addr add "10.77.$number.2/24" dev cable
      ip -n "$tag-cell" link set "eye$number" mtu 9000 up
      ip -n "$tag-$place" link set cable mtu 9000 up
      number=$((number + 1))
    done
    ;;
  down) down ;;
  *) echo "up or down" >&2; exit 2 ;;
esac
