# Sourced by the entry points: runs a command quietly and tells how it went.

# stage LOG TITLE COMMAND...: one line with the time it took. The output goes to the file LOG, and
# its end is shown when the command fails.
stage() {
    local log=$1 title=$2 start=$SECONDS status=0
    shift 2
    mkdir -p "$(dirname "$log")"
    printf '%-42s ' "$title"
    "$@" >"$log" 2>&1 </dev/null || status=$?
    if [ $status -eq 0 ]; then
        printf 'ok      %4d s\n' $((SECONDS - start))
        return 0
    fi
    printf 'FAILED  %4d s (status %d)\n' $((SECONDS - start)) "$status"
    tail -n "${STAGE_TAIL:-40}" "$log" | sed 's/^/    /'
    printf '    whole log: %s\n' "$log"
    return "$status"
}
