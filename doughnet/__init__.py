"""doughnet: the model that predicts how dough deforms, splits, merges and gets holes."""

__all__ = ["compute_threads"]


def compute_threads(threads: int) -> None:
    """Let tensors be computed by this many threads; results are reproducible bit for bit with 1."""
    import torch

    torch.set_num_threads(threads)
