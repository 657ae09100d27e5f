#!/usr/bin/env bash
# Peers for the tests in tests/lab that nobody here wrote; as root, on Debian. Tests whose peer is missing
# skip, and say so.
set -euo pipefail

PACKAGES=(
    # Modbus: a command-line client, and a C library for peers in both roles
    mbpoll libmodbus-dev gcc libc6-dev
    # V4L2: Debian's kernel in a virtual machine (tests/lab/vm)
    qemu-system-x86 mmdebstrap busybox-static kmod cpio e2fsprogs
)

apt-get update -qq
DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${PACKAGES[@]}"
