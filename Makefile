# Needs only Python 3.11+ and pip (or uv, or python3-venv): everything goes into this folder, see scripts/bootstrap.py.
#   make demo                        a synthetic four-camera recording, tracked and compared with the truth, in demo/
#   make test [ARGS="-k camera"]     the fast test suite;  ARGS="-m slow": the slow one;
#                                    ARGS="-m long": what takes minutes each, which no check runs
#   make lint                        format, lint, types, import contracts, ceilings of size
#   make bench [ARGS=table-2.3]      the benchmarks
#   make docs                        write the generated pages and build the site in build/site
#   make setup                       install everything again
#   make clean                       remove caches, builds and demo/;  make distclean: and .venv
# Without make: ./run demo, ./run test, and ./run <any hypose command>.
PYTHON ?= python3

.PHONY: demo test lint bench docs setup clean distclean
demo test lint bench docs setup:
	@$(PYTHON) scripts/bootstrap.py $@ $(ARGS)

clean:
	rm -rf .cache build dist demo opensim.log
	find . -name .venv -prune -o -name .git -prune -o -name __pycache__ -type d -prune -exec rm -rf {} +

distclean: clean
	rm -rf .venv
