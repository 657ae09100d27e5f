#!/usr/bin/env bash
# A virtual machine with Debian's own kernel, because V4L2 devices need kernel modules the host may not have:
#   image.sh FOLDER WHEEL==VERSION...     makes FOLDER/{vmlinuz,initrd.gz,disk.img}, all or nothing
# Debian 12 (python 3.11) with udev, v4l-utils and the given wheels; root; about 90 s, 600 MB while it works.
set -euo pipefail
out=$1
shift
wheels=("$@")
mkdir -p "$(dirname "$out")"
work=$(mktemp -d "${out}.XXXXXX")
trap 'rm -rf "$work"' EXIT
cd "$work"
say() { echo "image.sh: $*" >&2; }

say "kernel"
kernel=$(apt-cache depends linux-image-amd64 | awk '/Depends: linux-image-[0-9]/ {print $2; exit}')
[ -n "$kernel" ] || { say "apt knows no linux-image-amd64; run apt-get update"; exit 1; }
release=${kernel#linux-image-}
# _apt may not write here, and says so: root fetches it instead
apt-get download -q -o APT::Sandbox::User=root "$kernel" >&2
dpkg -x linux-image-*.deb kernel
depmod -b kernel "$release"
cp "kernel/boot/vmlinuz-$release" vmlinuz

say "root file system"
mmdebstrap --quiet --mode=root --variant=minbase --include=udev,kmod,python3,v4l-utils,libglib2.0-0 \
    --aptopt='Acquire::Languages "none"' --dpkgopt='path-exclude=/usr/share/man/*' \
    --dpkgopt='path-exclude=/usr/share/doc/*' --dpkgopt='path-exclude=/usr/share/locale/*' bookworm root >&2

say "wheels: ${wheels[*]}"
"${PYTHON:-python3}" -m pip install --quiet --disable-pip-version-check --no-deps --only-binary :all: --python-version 3.11 \
    --target root/opt/site "${wheels[@]}" >&2

# only the modules in question and what they need: a whole kernel's would triple the image
early="virtio_pci virtio_blk ext4 crc32c_generic"
late="uvcvideo vhci-hcd vivid virtio_console 9p 9pnet_virtio"
needed() {
    for module in "$@"; do modprobe -d kernel -S "$release" --show-depends "$module"; done |
        awk '/^insmod/ {print $2}' | awk '!seen[$0]++'
}
# modules go under usr/lib: /lib of the new root is a link
modules=root/usr/lib/modules/$release
needed $early $late | while read -r file; do
    target=$modules/${file#*/modules/"$release"/}
    mkdir -p "$(dirname "$target")"
    cp "$file" "$target"
done
cp kernel/lib/modules/"$release"/modules.{builtin,order} "$modules"
depmod -b root "$release"

mkdir -p early/{bin,proc,sys,dev,newroot,lib} root/lab
cp "$(command -v busybox)" early/bin/busybox
number=10
for file in $(needed $early); do
    cp "$file" "early/lib/$number-$(basename "$file")"
    number=$((number + 1))
done
cat > early/init <<'INIT'
#!/bin/busybox sh
/bin/busybox mount -t proc proc /proc
/bin/busybox mount -t devtmpfs dev /dev
for module in /lib/*.ko; do /bin/busybox insmod "$module"; done
tries=0
while [ ! -b /dev/vda ] && [ $tries -lt 200 ]; do /bin/busybox usleep 20000; tries=$((tries + 1)); done
/bin/busybox mount -t ext4 /dev/vda /newroot || exec /bin/busybox poweroff -f
exec /bin/busybox switch_root /newroot /sbin/lab-init
INIT
chmod +x early/init
(cd early && find . | cpio --quiet -o -H newc) | gzip -1 > initrd.gz

# no systemd: udev gives the stable names, and an agent runs what the test asks for
cat > root/sbin/lab-init <<'INIT'
#!/bin/sh
export PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LANG=C.UTF-8
mount -t proc proc /proc 2>/dev/null
mount -t sysfs sys /sys
mount -t devtmpfs dev /dev 2>/dev/null
mount -t tmpfs tmpfs /tmp
mount -t tmpfs tmpfs /run
for module in virtio_console 9pnet_virtio 9p; do modprobe $module; done
/lib/systemd/systemd-udevd --daemon
udevadm trigger --action=add
udevadm settle --timeout=60
mount -t 9p -o trans=virtio,version=9p2000.L,msize=262144,cache=none lab /lab || echo "lab-init: no shared folder"
python3 -u /lab/agent.py
echo "lab-init: agent ended, $?"
echo o > /proc/sysrq-trigger
sleep 5
INIT
chmod +x root/sbin/lab-init

say "disk"
truncate -s 1500M disk.img
mke2fs -q -t ext4 -d root disk.img
rm -rf kernel root early ./*.deb
chmod 755 .
mkdir -p "$(dirname "$out")"
rm -rf "$out"
mv "$work" "$out"
trap - EXIT
say "$out: $(du -sh "$out" | cut -f1)"
