"""Which motion, found in noisy images alone, brings the clean previous frame closest to the clean current one?

    nte render datasets/correspondence.yaml --out data/correspondence
    python tests/benchmarks/correspondence.py data/correspondence/test [--times] [--json FILE] [--pictures FOLDER]

Returns 1 if what the project promises does not hold. docs/correspondence.md says how each number is computed.
"""




SIZE = 256  # of the discs
