# The first process of a host: FOLDER NAME HIDDEN [its own files are in FOLDER, those in HIDDEN are nobody's]. When its input
# ends it ends, and with it whatever runs on this host.
set -eu
# As those outside know it.
read -r pid rest </proc/self/stat
cd /
mount -t proc proc /proc
mount --bind "$1" /mnt
[ ! -d "$3" ] || mount -t tmpfs hidden "$3"
for own in root run tmp opt; do mount --bind "/mnt/$own" "/$own"; done
mount --bind /mnt/shadow /etc/shadow
umount /mnt
echo "$2" >/proc/sys/kernel/hostname
# In the background once it listens.
[ ! -e /opt/sshd/config ] || /usr/sbin/sshd -f /opt/sshd/config -E /run/sshd.log
echo "$pid"
exec 3<&0
cat <&3 >/dev/null &
# Takes leave of every process that has nobody else.
wait $!
