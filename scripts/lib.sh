# Shared by the scripts beside it; sourced, never run. Bash, strict.
set -euo pipefail

ROOT=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)
CACHE="$ROOT/.cache"                            # rebuilt at will; ignored by git
STATE="${XDG_RUNTIME_DIR:-/tmp}/phm-$(id -u)"   # what we started, for as long as it runs
LOCKS="$ROOT/scripts/locks"
PYTHONS=(3.12 3.11 3.13 3.10)                   # the ROS wheels exist for these; 3.12 is Jazzy's own
export PIP_DISABLE_PIP_VERSION_CHECK=1

say() { printf '== %s\n' "$*" >&2; }

# One sentence that says what is wrong and what to do, then out.
fail() {
  printf 'phm: %s\n' "$*" >&2
  exit 1
}

have() { command -v -- "$1" >/dev/null 2>&1; }

am_root() { [[ $(id -u) == 0 ]]; }

# Debian and its children, where we may install packages.
can_install() { am_root && have apt-get; }

# distribution: the ID of os-release; release: its code name.
distribution() { (. /etc/os-release && printf '%s' "${ID:-unknown}"); }
release() { (. /etc/os-release && printf '%s' "${VERSION_CODENAME:-unknown}"); }

# apt_install PACKAGE... : quietly, without questions; another apt that is at work is waited for.
apt_install() {
  say "Installing $* with apt"
  local log
  log=$(mktemp)
  if ! { _apt update && _apt install --yes --no-install-recommends "$@"; } >"$log" 2>&1; then
    tail -n 20 -- "$log" >&2
    rm -f -- "$log"
    fail "apt could not install $*: see the lines above; install them by hand and call again."
  fi
  rm -f -- "$log"
}

_apt() { DEBIAN_FRONTEND=noninteractive apt-get --quiet -o DPkg::Lock::Timeout=120 "$@"; }

# wait_until SECONDS COMMAND... : polls the command until it succeeds or the time is up.
wait_until() {
  local end=$((SECONDS + $1))
  shift
  until "$@" >/dev/null 2>&1; do
    ((SECONDS < end)) || return 1
    sleep 0.2
  done
}

# digest FILE... : one short hash over names and contents.
digest() { (cd -- "$ROOT" && sha256sum -- "$@" | sha256sum | cut -c1-16); }

# Prints "VERSION PATH" for each Python of PYTHONS that this machine has and that starts, best first.
# A pyenv shim for a version that is not chosen exists but does not start, so each is asked.
pythons() {
  local version candidate found
  for version in "${PYTHONS[@]}"; do
    for candidate in "python$version" "/usr/bin/python$version" \
      "${PYENV_ROOT:-$HOME/.pyenv}"/versions/"$version".*/bin/python3 python3 /usr/bin/python3; do
      found=$("$candidate" -c 'import sys; print("%d.%d" % sys.version_info[:2], sys.executable)' 2>/dev/null) || continue
      [[ ${found%% *} == "$version" ]] || continue
      printf '%s\n' "$found"
      break
    done
  done
}

# The Python that the project's own environment is made with. Debian's lacks venv until python3-venv is installed.
best_python() {
  local version path found
  found=$(pythons) # all of it: a reader that returns early would end its writer with an error message
  while read -r version path; do
    [[ -n $path ]] || continue
    if "$path" -c 'import ensurepip, venv' 2>/dev/null; then
      printf '%s' "$path"
      return
    fi
  done <<<"$found"
  can_install || fail "no Python 3.10 to 3.13 with venv was found: install python3 and python3-venv."
  apt_install python3 python3-venv
  found=$(pythons)
  read -r version path <<<"$found" && [[ -n $path ]] || fail "this release has no Python 3.10 to 3.13: install one of them."
  printf '%s' "$path"
}

# The archive that apt takes the running release from, as it is set up on this machine.
mirror_uri() {
  local uri codename
  while read -r uri codename; do
    [[ $codename == "$(release)" ]] || continue
    printf '%s' "${uri%/}"
    return
  done < <(apt-get indextargets --format '$(REPO_URI) $(CODENAME)' 'Created-By: Packages')
  fail "apt has no source for $(release): add one and call again."
}

# apt_download RELEASE FOLDER PACKAGE... : the packages of another Debian release into FOLDER. Its package lists are used once and
# removed, so the machine's own sources stay unchanged.
apt_download() {
  local release=$1 folder=$2 lists result=0
  shift 2
  lists=$(mktemp -d)
  chmod 755 -- "$lists"
  mkdir -p -- "$lists/state/partial" "$lists/cache/archives/partial"
  printf 'deb [signed-by=/usr/share/keyrings/debian-archive-keyring.gpg] %s %s main\n' "$(mirror_uri)" "$release" >"$lists/sources.list"
  local apart=(-o "Dir::Etc::SourceList=$lists/sources.list" -o Dir::Etc::SourceParts=/dev/null
    -o "Dir::State::Lists=$lists/state" -o "Dir::Cache=$lists/cache" -o APT::Sandbox::User=root)
  if ! { _apt "${apart[@]}" update && (cd -- "$folder" && _apt "${apart[@]}" download "$@"); } >"$lists/log" 2>&1; then
    tail -n 15 -- "$lists/log" >&2
    result=1
  fi
  rm -rf -- "$lists"
  return "$result"
}

# install_locked PYTHON [--OPTION...] LOCK... : the packages of these locks, each file's hash checked; options are pip's.
# What comes as source alone (one dependency of rclpy does) is built with the locked setuptools, so nothing unlocked is
# fetched.
install_locked() {
  local python=$1 name requirements=()
  shift
  "$python" -m pip install --quiet --quiet --require-hashes --requirement "$LOCKS/build.lock" || return 1
  for name in "$@"; do
    case $name in --*) requirements+=("$name") ;; *) requirements+=(--requirement "$LOCKS/$name.lock") ;; esac
  done
  "$python" -m pip install --quiet --quiet --require-hashes --use-pep517 --no-build-isolation "${requirements[@]}"
}

# For a second Docker Engine, in new namespaces: not the machine's sockets and PID files; not the shared memory of ROS processes in
# another network namespace; the network interfaces of this one, with the control groups of before.
own_mounts() {
  mount -t tmpfs -o mode=755 tmpfs /run
  mount -t tmpfs -o mode=1777 tmpfs /dev/shm
  mkdir -- /run/cgroup
  mount --rbind /sys/fs/cgroup /run/cgroup
  mount -t sysfs sysfs /sys
  mount --move /run/cgroup /sys/fs/cgroup
}
