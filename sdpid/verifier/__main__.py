"""Run the checker as a folder, ``python -I -S verifier FILE``, or as a module of the package."""

import sys
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

if __package__:
    from sdpid.verifier.command import main
else:
    # Run or copied by itself, whatever it is called then. Nothing that lies beside it is imported:
    # a json.py there is not the standard library's.
    here = Path(__file__).resolve().parent
    sys.path.pop(0)
    spec = spec_from_file_location(
        "_verifier", here / "__init__.py", submodule_search_locations=[str(here)]
    )
    assert spec is not None
    sys.modules[spec.name] = module_from_spec(spec)
    main = import_module(f"{spec.name}.command").main

sys.exit(main(sys.argv[1:]))
