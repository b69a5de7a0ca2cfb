"""Make the documentation's pictures anew, all or those named: `.venv/bin/python docs/make_pictures.py [rig] [report] …`.

Each script in docs/pictures makes its own, from runs it makes for them. test/test_docs_pictures.py compares their numbers with
the text and with a run.
"""

import subprocess
import sys
from pathlib import Path

SCRIPTS = {path.stem: path for path in sorted((Path(__file__).parent / "pictures").glob("*.py"))}

if __name__ == "__main__":
    wanted = sys.argv[1:] or list(SCRIPTS)
    if unknown := set(wanted) - SCRIPTS.keys():
        sys.exit(f"no picture {', '.join(sorted(unknown))}: there are {', '.join(SCRIPTS)}")
    for name in wanted:
        subprocess.run([sys.executable, str(SCRIPTS[name])], check=True)
