# Sourced by the scripts of this folder: steps that print what they do, their duration and the remaining time.

planned_steps=
step_number=0
step_count=0
seconds_left=0
declare -A step_about_s=() step_label=()

plan_step() { # plan_step NAME ABOUT_S LABEL
  planned_steps="$planned_steps $1"
  step_about_s[$1]=$2
  step_label[$1]=$3
  step_count=$((step_count + 1))
  seconds_left=$((seconds_left + $2))
}

planned() {
  case "$planned_steps " in *" $1 "*) return 0 ;; *) return 1 ;; esac
}

give_up() {
  printf 'error: %s\n' "$*" >&2
  exit 1
}

# Packages of the system are installed where we may; otherwise the one line to type is printed.
system_packages() { # system_packages WHY PACKAGE...
  local why=$1
  shift
  if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    printf '%s: installing %s from the system'\''s packages ...\n' "$why" "$*" >&2
    {
      [ -n "$(find "${TMPDIR:-/tmp}/heli-apt-updated" -mmin -60 2>/dev/null)" ] ||
        { apt-get update && touch "${TMPDIR:-/tmp}/heli-apt-updated"; } || true
      DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends "$@"
    } </dev/null >"${TMPDIR:-/tmp}/heli-apt.log" 2>&1 && return
    tail -n 5 "${TMPDIR:-/tmp}/heli-apt.log" >&2
    give_up "apt-get could not install $*"
  elif command -v apt-get >/dev/null; then
    give_up "$why; type: sudo apt-get install $*"
  elif command -v dnf >/dev/null; then
    give_up "$why; install it with your package manager, for example: sudo dnf install gcc-c++ python3 python3-devel clang"
  else
    give_up "$why; install it with your package manager (on Debian it is called: $*)"
  fi
}

ticker() { # shows on a terminal that time passes
  local start=$SECONDS
  while sleep 1; do printf '\r%s %d s ' "$1" $((SECONDS - start)); done
}

# Runs the next planned step; its output is shown only when it fails.
run_step() { # run_step COMMAND...
  step_number=$((step_number + 1))
  local name about label start=$SECONDS log status=0 ticker_pid=
  name=$(echo "$planned_steps" | cut -d' ' -f$((step_number + 1)))
  about=${step_about_s[$name]}
  label="[$step_number/$step_count] ${step_label[$name]} (about $about s; $seconds_left s left in all) ..."
  log=$(mktemp)
  printf '%s ' "$label"
  if [ -t 1 ]; then
    ticker "$label" &
    ticker_pid=$!
  fi
  ("$@") >"$log" 2>&1 </dev/null || status=$?
  if [ -n "$ticker_pid" ]; then
    kill "$ticker_pid" 2>/dev/null
    wait "$ticker_pid" 2>/dev/null || true
    printf '\r%s ' "$label"
  fi
  seconds_left=$((seconds_left - about))
  if [ $status != 0 ]; then
    printf 'failed after %d s\n' $((SECONDS - start))
    tail -n 40 "$log" >&2
    rm -f "$log"
    give_up "step '${step_label[$name]}' failed: the lines above are the end of its output"
  fi
  printf 'done in %d s\n' $((SECONDS - start))
  rm -f "$log"
}
