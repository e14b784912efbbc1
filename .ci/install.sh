#!/bin/sh
# install.sh PYTHON WHAT...: into the environment of that Python, with uv, which fetches side by side. Where uv
# cannot be had, or does not find its way to the packages as pip does, with pip. In the versions of the file
# $CONSTRAINTS, also of what builds; without it the newest.
python=$1
shift
if [ -n "${CONSTRAINTS:-}" ]; then
    export UV_CONSTRAINT="$CONSTRAINTS" UV_BUILD_CONSTRAINT="$CONSTRAINTS" PIP_CONSTRAINT="$CONSTRAINTS"
else
    set -- --upgrade "$@"
fi
if "$python" -m uv --version >/dev/null 2>&1 || "$python" -m pip --quiet install uv >/dev/null 2>&1; then
    "$python" -m uv pip install --quiet --python "$python" "$@" && exit 0
    echo "setup: uv did not succeed; trying pip (a minute or two)"
else
    echo "setup: no uv here; pip takes longer (a minute or two)"
fi
exec "$python" -m pip --quiet install --prefer-binary --progress-bar off "$@"
