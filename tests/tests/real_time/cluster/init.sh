# The first process of a host: FOLDER NAME HIDDEN. FOLDER has the host's own files; the folder HIDDEN is hidden on the host.
# When its input ends, this process ends, and with it all processes of the host.
set -eu
# The process id outside of the host.
read -r pid rest </proc/self/stat
cd /
mount -t proc proc /proc
mount --bind "$1" /mnt
[ ! -d "$3" ] || mount -t tmpfs hidden "$3"
for own in root run tmp opt; do mount --bind "/mnt/$own" "/$own"; done
mount --bind /mnt/shadow /etc/shadow
umount /mnt
echo "$2" >/proc/sys/kernel/hostname
# sshd goes to the background when it accepts connections.
[ ! -e /opt/sshd/config ] || /usr/sbin/sshd -f /opt/sshd/config -E /run/sshd.log
echo "$pid"
exec 3<&0
cat <&3 >/dev/null &
# `wait` also collects the exit statuses of orphaned processes.
wait $!
