#!/usr/bin/env bash
# Removes from this computer what scripts/install.sh installed, and nothing else. See --help.
set -euo pipefail

# shellcheck source=scripts/install-files
. "$(dirname "${BASH_SOURCE[0]}")/install-files"
set_places /usr/local

say() { printf '%s: %s\n' "$(basename "$0")" "$*" >&2; }

usage() {
    cat <<END
usage: sudo uninstall.sh [--purge] [--dry-run]

Stops arpd, which restores the publishers' own QoS, and removes it. Your configuration stays.

  --purge    also remove /etc/arpd, /etc/default/arpd, drop-ins of the units and the user arpd
  --dry-run  print every step, change nothing; needs no root
  --help     this text

exit codes: 0 done, 1 failed, 2 wrong usage
END
}

step() {
    if $dry_run; then
        say "would $1"
    else
        if [ -t 2 ]; then say "$1"; fi
        "${@:2}"
    fi
}

is_there() { [ -e "$1" ] || [ -L "$1" ]; }

remove() {
    local path
    for path in "$@"; do
        if is_there "$path"; then step "remove $path" rm -rf "$path"; fi
    done
}

# remove_target ... TARGET: for each_file and each_folder.
remove_target() { remove "${!#}"; }

# The daemon stops first, so that it can restore the QoS of the relays' publishers.
stop() {
    local unit
    for unit in "${all_units[@]}"; do
        if [ -e "$units/$unit.service" ]; then step "stop and disable $unit" disable "$unit"; fi
    done
}

disable() {
    if [ -d /run/systemd/system ]; then systemctl stop "$1"; fi
    systemctl --quiet disable "$1"
}

remove_program() {
    local link folders
    each_file remove_target ''
    each_folder remove_target ''
    remove "$libexec"
    library_links | while IFS= read -r link; do remove "$link"; done
    if [ "$(readlink /usr/local/bin/arpd)" = /opt/arpd/bin/arpd ]; then remove /usr/local/bin/arpd; fi
    if [ -d /opt/arpd/versions ]; then remove /opt/arpd/{current,bin,versions}; fi
    folders=("$units"{/arpd.service.d,} "$catalog" "$sysusers" "$share" "${completions%/*}" "$completions" /opt/arpd)
    $dry_run || rmdir "$man" 2>/dev/null || true # the folder above is Debian's
    $dry_run || rmdir --parents --ignore-fail-on-non-empty "${folders[@]}" 2>/dev/null || true
    $dry_run || journalctl --update-catalog || true
    if ! $dry_run && [ -d /run/systemd/system ]; then
        systemctl daemon-reload
        systemctl reset-failed 'arpd*' 2>/dev/null || true
    fi
}

remove_user() {
    userdel arpd
    if getent group arpd >/dev/null; then groupdel arpd; fi
}

# A uid below 1000 is a system user; a person may be called arpd, too.
has_system_user() {
    local uid
    uid=$(id -u arpd 2>/dev/null) && [ "$uid" -lt 1000 ]
}

main() {
    purge=false dry_run=false
    for option in "$@"; do
        case $option in
        --purge) purge=true ;;
        --dry-run) dry_run=true ;;
        --help | -h)
            usage
            exit 0
            ;;
        *)
            say "unknown option $option"
            usage >&2
            exit 2
            ;;
        esac
    done
    if has_package; then
        say "arpd came with the Debian package arpd-ros; remove that: sudo apt remove arpd-ros"
        exit 1
    fi
    if ! $dry_run && [ "$(id -u)" != 0 ]; then
        say "not root; sudo $0"
        exit 1
    fi
    local path theirs=(/etc/arpd /etc/default/arpd{,.new} /etc/systemd/system/arpd{,-relay,-relay-far,-peer}.service.d)
    stop
    remove_program
    if $purge; then
        remove "${theirs[@]}"
        if has_system_user; then step "remove the user arpd" remove_user; fi
    else
        for path in "${theirs[@]}"; do
            if is_there "$path"; then say "left: $path"; fi
        done
        if has_system_user; then say "left: the user arpd"; fi
    fi
    if is_there /opt/arpd && ! $dry_run; then say "left: /opt/arpd, with files that are not arpd's"; fi
    say "left: arpd's entries in the journal"
}

main "$@"
