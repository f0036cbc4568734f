#!/usr/bin/env bash
# Installs arpd on this computer, or upgrades it.
#
# A version lives in /opt/arpd/versions/VERSION-HASH: a virtual environment, whose share/arpd has the files that go
# elsewhere. The script makes it beside the version in use and switches /opt/arpd/current to it in one step. The hash
# covers all installed files, so a second run finds nothing to do. If a version does not start, the script switches back.
set -euo pipefail
umask 022

source=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
# shellcheck source=scripts/bootstrap
. "$source/scripts/bootstrap"
# shellcheck source=scripts/install-files
. "$source/scripts/install-files"
# shellcheck source=scripts/install-checks
. "$source/scripts/install-checks"

prefix=/opt/arpd
set_places /usr/local
command_link=/usr/local/bin/arpd
config=/etc/arpd/arpd.yaml


usage() {
    cat <<END
usage: sudo scripts/install.sh [--robot | --ceddp] [--no-start] [--dry-run]

Installs arpd under /opt/arpd with its systemd units, or upgrades it, from a checkout or an unpacked archive.
An upgrade never changes /etc/arpd/arpd.yaml and /etc/default/arpd.

  --robot     this is the robot computer: enable arpd and arpd-relay. The default of a first installation;
              an upgrade keeps the enabled units
  --ceddp     this is the other end of the link: enable arpd-peer and arpd-relay-far, which waits until
              relay.link_domain in /etc/arpd/arpd.yaml gives the relay two ends
  --no-start  start and restart nothing, for building an image
  --dry-run   check, print every step, change nothing; needs no root
  --help      this text

PYTHON=/usr/bin/python3.12 chooses a Python. pip takes its settings (proxy, index) from PIP_* and pip.conf.
exit codes: 0 done, 1 failed (the old version still runs), 2 wrong usage
END
}

# step WHAT COMMAND...: runs the command and shows WHAT on a terminal; a dry run only shows it.
step() {
    if $dry_run; then
        say "would $1"
    else
        note "      $1"
        "${@:2}"
    fi
}

read_options() {
    role='' start=true dry_run=false
    for option in "$@"; do
        case $option in
        --robot | --ceddp)
            if [ -n "$role" ] && [ "$role" != "${option#--}" ]; then
                say "give either --robot or --ceddp"
                exit 2
            fi
            role=${option#--}
            ;;
        --no-start) start=false ;;
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
}

# -- the new version, beside the one in use

name_version() {
    local version hash
    version=$(source_version)
    hash=$(
        cd "$source"
        {
            "$python" -VV
            echo "$python $ros"
            find "${to_build[@]}" etc systemd scripts/{uninstall.sh,install-files} \
                -type f -not -path '*/__pycache__/*' -print0 | LC_ALL=C sort -z | xargs -0 sha256sum
        } | sha256sum
    )
    id=$version-${hash:0:12}
    new=$prefix/versions/$id
    old=$(readlink -e $prefix/current || true)
}

is_built() { [ -e "$new/share/arpd/complete" ] && "$new/bin/arpd" --version >/dev/null 2>&1; }

build() {
    building=true
    rm -rf "$new" $prefix/work.*
    work=$(mktemp -d $prefix/work.XXXXXX)
    TMPDIR=$work "$python" -m venv "${venv_options[@]}" "$new" || die "$python cannot make a virtual environment in $new"
    pip_install "$new/bin/python" -m pip install
    with_ros "$new/bin/python" -c "$imports" || die "the new version cannot import its modules; see the error above"
    ln -s "$("$new/bin/python" -c 'import sys; print("python%d.%d" % sys.version_info[:2])')" "$new/lib/python"
    mkdir -p "$new/share/arpd/scripts"
    cp -R "$source"/{etc,systemd} "$new/share/arpd"
    install -D "$source/$profile" "$new/share/arpd/$profile"
    cp "$source"/scripts/{uninstall.sh,install-files} "$new/share/arpd/scripts"
    chmod -R u=rwX,go=rX "$new/share/arpd"
    touch "$new/share/arpd/complete"
    building=false
}

make_version() {
    if is_built; then
        [ "$old" = "$new" ] || note "      $new is built already"
        return
    fi
    if ! has_venv; then
        step "install ${python##*/}-venv with apt" need "no-such-command=${python##*/}-venv"
        $dry_run || has_venv || die "$python still has no venv module; install it or set PYTHON to another Python"
    fi
    step "make $new with pip; takes some minutes on a Pi" build
}

check_config() {
    local domain
    [ -e $config ] || return 0
    # The units' own, which the check compares with relay.link_domain.
    domain=$(sed -n 's/^ROS_DOMAIN_ID=//p' /etc/default/arpd 2>/dev/null | tail -n 1 || true)
    if ! ROS_DOMAIN_ID=${domain//\"/} "$new/bin/arpd" check --no-interfaces $config >/dev/null; then
        die "arpd $id refuses $config for the faults above; correct them and run this script again." \
            "Nothing was changed; the next run reuses $new"
    fi
}

# -- switching to it

# put MODE FILE TARGET: replaces a target that differs in one step.
put() {
    if cmp -s "$2" "$3" && [ "$(stat -c '%a %U' "$3")" = "${1#0} root" ]; then return; fi
    changed=true
    step "install $3" replace "$@"
}

replace() {
    mkdir -p "$(dirname "$3")"
    install -m "$1" "$2" "$3.arpd-new"
    mv -fT "$3.arpd-new" "$3"
}

# put_back MODE FILE TARGET: like put, but an old version may lack a file that the new one has.
put_back() { if [ -e "$2" ]; then put "$@"; else rm -f "$3"; fi; }

# put_folder FOLDER TARGET: an old version may lack it, too.
put_folder() {
    if [ ! -e "$1" ] || diff -rq "$1" "$2" >/dev/null 2>&1; then return; fi
    placed=true
    step "install $2" replace_tree "$@"
}

replace_tree() {
    mkdir -p "$share"
    rm -rf "$2.arpd-new"
    cp -R --no-preserve=mode,ownership "$1" "$2.arpd-new"
    rm -rf "$2"
    mv -T "$2.arpd-new" "$2"
}

# One link, so that nodes which run with the system's Python can import arpd and nothing else of its environment.
put_library() {
    if [ -z "$site" ] || [ "$(readlink "$site/arpd")" = $library ]; then return; fi
    placed=true
    step "install $site/arpd" link_library
}

link_library() {
    mkdir -p "$site"
    ln -sfnT $library "$site/arpd"
}

# keep FILE TARGET OLD_DEFAULT: keeps the operator's file and puts a changed default beside it.
keep() {
    if [ ! -e "$2" ]; then
        step "install $2" replace 0644 "$1" "$2"
    elif ! cmp -s "$1" "$2" && ! cmp -s "$1" "$3" && ! cmp -s "$1" "$2.new"; then
        step "keep $2 and install the new default as $2.new" replace 0644 "$1" "$2.new"
    fi
}

point_to() {
    ln -sfn "versions/${1##*/}" $prefix/current.new
    mv -fT $prefix/current.new $prefix/current
    # bin/ is a folder with one link and not a link itself, because Python would not find its pyvenv.cfg from there.
    mkdir -p $prefix/bin "$(dirname $command_link)"
    ln -sfn ../current/bin/arpd $prefix/bin/arpd
    ln -sfn $prefix/bin/arpd $command_link
}

tell_systemd() {
    systemd-sysusers "$sysusers/arpd.conf"
    journalctl --update-catalog || true # the catalog only explains messages
    if $systemd_runs; then systemctl daemon-reload; fi
}

state() { systemctl show --property=ActiveState --value "$1"; }

find_running() {
    running=()
    local unit
    $systemd_runs || return 0
    for unit in "${all_units[@]}"; do
        case $(state "$unit") in active | activating | reloading) running+=("$unit") ;; esac
    done
}

switch() {
    changed=false placed=false restarted=()
    find_running
    if [ "$old" != "$new" ]; then
        changed=true
        $dry_run || switched=true
        step "point /opt/arpd/current to versions/$id" point_to "$new"
    fi
    each_file put "$source"
    each_folder put_folder "$source"
    put_library
    keep "$source/etc/arpd/arpd.yaml" $config "$old/share/arpd/etc/arpd/arpd.yaml"
    keep "$source/systemd/arpd.default" /etc/default/arpd "$old/share/arpd/systemd/arpd.default"
    if $changed; then step "make the system user arpd and reload systemd" tell_systemd; fi
}

# Waits for READY and two seconds more, in case a daemon dies in its first ticks.
bring_up() {
    local main
    systemctl reset-failed "$1" 2>/dev/null || true
    systemctl restart "$1" || return 1
    main=$(systemctl show --property=MainPID --value "$1")
    sleep 2
    [ "$(state "$1")" = active ] && [ "$(systemctl show --property=MainPID --value "$1")" = "$main" ]
}

tell_why() {
    say "$1 does not keep running; its journal ends with:"
    journalctl --unit "$1" --lines 8 --no-pager --output cat >&2 || true
}

restart_running() {
    local unit
    if ! $start || ! $changed; then return; fi
    for unit in "${running[@]}"; do
        restarted+=("$unit")
        if step "restart $unit" bring_up "$unit"; then continue; fi
        tell_why "$unit"
        die "the new version does not run here"
    done
}

back_to_old() {
    local unit link
    if [ -z "$old" ]; then
        rm $prefix/current
        return
    fi
    say "going back to ${old##*/}"
    point_to "$old"
    each_file put_back "$old/share/arpd"
    each_folder put_folder "$old/share/arpd"
    if [ ! -e $library ]; then library_links | while IFS= read -r link; do rm "$link"; done; fi
    tell_systemd
    for unit in "${restarted[@]}"; do bring_up "$unit" || tell_why "$unit"; done
}

# A first installation that does not start stays, because there is no version to go back to. A unit may be enabled and
# stopped: the Debian package leaves its units so when it is removed.
set_role() {
    local unit wanted other=()
    failed=()
    if [ -z "$role" ] && [ -n "$old" ]; then return; fi
    case ${role:-robot} in
    robot) wanted=(arpd-relay arpd) other=(arpd-peer arpd-relay-far) ;;
    ceddp) wanted=(arpd-relay-far arpd-peer) other=(arpd arpd-relay) ;;
    esac
    for unit in "${other[@]}"; do
        systemctl --quiet is-enabled "$unit" 2>/dev/null || continue
        step "stop and disable $unit" disable "$unit"
    done
    for unit in "${wanted[@]}"; do
        if ! systemctl --quiet is-enabled "$unit" 2>/dev/null; then
            step "enable $unit" systemctl --quiet enable "$unit"
        fi
        if ! $start || [ "$(state "$unit")" = active ] || step "start $unit" bring_up "$unit"; then continue; fi
        tell_why "$unit"
        failed+=("$unit")
    done
}

disable() {
    systemctl --quiet disable "$1"
    if $systemd_runs && $start; then systemctl stop "$1"; fi
}

# Removes all versions except this one and the previous one. With --no-start an even older one may still run.
remove_old_versions() {
    local version
    if ! $start || [ "$old" = "$new" ]; then return; fi
    for version in "$prefix"/versions/*; do
        case $version in "$new" | "$old" | "$prefix/versions/*") ;; *) step "remove $version" rm -rf "$version" ;; esac
    done
}

row() { printf '  %-42s %s\n' "$1" "$2"; }

tell() {
    local unit
    echo
    if $changed || $placed; then echo "arpd $id is installed:"; else echo "arpd $id was installed already; nothing was changed:"; fi
    row "$new" "$("$new/bin/python" -VV | cut -d' ' -f1,2), ROS 2 Jazzy from $ros"
    row $command_link "the command"
    row "$units" "the units; their launcher is in $libexec"
    row "$share/{prometheus,grafana}" "scrape configuration, rules, alerts; dashboards"
    if [ -n "$site" ]; then row "$site/arpd" "the library, for your nodes"; fi
    row "$share/fastdds.xml" "for your nodes: export FASTRTPS_DEFAULT_PROFILES_FILE=$share/fastdds.xml"
    row $config "your configuration"
    if [ -e $config.new ]; then row $config.new "the new default, to compare with yours"; fi
    row /etc/default/arpd "your environment for the units"
    if [ -e /etc/default/arpd.new ]; then row /etc/default/arpd.new "the new default, to compare with yours"; fi
    for unit in "${all_units[@]}"; do
        row "$unit" "$(systemctl is-enabled "$unit" 2>/dev/null || true)$(! $systemd_runs || echo ", $(state "$unit")")"
    done
    echo "next:"
    row "arpd status; arpd top" "link, plan and topics; the same, live"
    row "curl localhost:9464/metrics" "metrics for Prometheus"
    row "sudoedit $config" "add your topics; then: arpd check && sudo systemctl reload arpd"
    row "journalctl -u 'arpd*'" "the decision log"
    row "sudo $prefix/current/share/arpd/scripts/uninstall.sh" "remove arpd"
    [ ${#failed[@]} -eq 0 ] || die "installed, but ${failed[*]} did not start; correct the fault in the journal," \
        "then: sudo systemctl restart ${failed[*]}"
}

# Runs at every end of the script: removes a half-made version and switches back from one that does not run.
finish() {
    set +e
    trap '' INT TERM HUP
    if $switched; then back_to_old; fi
    if $building; then rm -rf "$new"; fi
    rm -rf "$work"
    rmdir $prefix/versions $prefix 2>/dev/null
}

main() {
    read_options "$@"
    building=false switched=false work=''
    phases=7
    phase "check this computer"
    check
    name_version
    if ! $dry_run; then
        mkdir -p $prefix/versions
        exec 9<$prefix
        flock --nonblock 9 || die "another installation is running; wait for its end"
        trap finish EXIT
        trap 'exit 1' INT TERM HUP
    fi
    phase "install arpd $id, its solvers$([ "$ros" = apt ] || echo ", ROS 2 Jazzy") into a folder of its own"
    make_version
    phase "check $config with the new version"
    if $dry_run; then say "would check $config with the new version"; else check_config; fi
    phase "switch to the new version"
    switch
    phase "restart running units"
    restart_running
    switched=false
    phase "enable and start the units of this computer"
    set_role
    phase "remove old versions, except the previous one"
    remove_old_versions
    if $dry_run; then say "dry run: nothing was changed"; else tell; fi
}

main "$@"
