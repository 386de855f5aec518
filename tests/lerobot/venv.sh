#!/bin/sh
# Makes a virtual environment with LeRobot's own loader: tests/lerobot/venv.sh FOLDER
#
# LeRobot depends on torch, whose wheels for Linux on x86-64 bring gigabytes of CUDA along. Plugins and
# cameras are loaded without torch. Datasets need it: the torch of the interpreter is used, for example
# Debian's (apt-get install python3-torch python3-torchvision, 152 MB). LEROBOT_PYTHON names another
# interpreter.
set -eu
folder=$1
here=$(dirname "$0")
plugin="$here/../../python-plugins/lerobot_camera_gelstereo"
# Parallel test processes ask for the same folder: one makes it and the others wait.
mkdir -p "$folder"
exec 9>"$folder/lock"
flock 9
newer() { find "$here" "$plugin" -type f -not -path '*/__pycache__/*' -newer "$folder/made"; }
if [ -e "$folder/made" ] && [ -z "$(newer)" ]; then exit 0; fi

python=${LEROBOT_PYTHON:-/usr/bin/python3}
[ -x "$python" ] || python=python3
[ -x "$folder/bin/python" ] || "$python" -m venv --system-site-packages "$folder"
pip="$folder/bin/python -m pip --quiet --disable-pip-version-check"

$pip install --no-deps 'lerobot==0.4.4' 'lerobot_camera_dummy==0.1.0'
# The plugin last, so that a changed one replaces what was there.
if torch=$("$folder/bin/python" -c 'import torch, torchvision; print(torch.__version__)' 2>/dev/null); then
    $pip install --no-deps 'accelerate<1'
    case $torch in
    1.*) set -- 'numpy<2' 'pyarrow<22' ;; # that torch was built for NumPy 1; pyarrow 22 wants NumPy 2
    *) set -- ;;
    esac
    $pip install --requirement "$here/requirements.txt" --requirement "$here/requirements-datasets.txt" "$@"
else
    echo "lerobot: $python has no torch and torchvision; datasets are not tested" >&2
    $pip install --requirement "$here/requirements.txt"
fi
$pip install --no-deps --force-reinstall "$plugin"
touch "$folder/made"
