"""The version of nte, which is also stored in the files that it writes, and those of packages that it computes with."""

__version__ = "0.1.0"

# What computes the images of denoisers. onnxruntime-gpu and onnxruntime-directml take the place of onnxruntime.
DENOISING = (
    "numpy", "torch", "pyoidn", "onnxruntime", "onnxruntime-gpu", "onnxruntime-directml", "onnxruntime-ep-webgpu",
    "openvino",
)  # fmt: skip


def versions_of(*packages: str) -> dict[str, str]:
    """Look up the versions of installed packages; "none" for one that is missing."""
    from importlib.metadata import PackageNotFoundError, version  # slow to import, and `import nte` looks nothing up

    found = {}
    for name in packages:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "none"
    return found
