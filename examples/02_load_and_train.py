"""Train one step from a dataset with two loader workers.

Run: python examples/02_load_and_train.py DATASET
"""

import sys

import torch
from torch import nn
from torch.utils.data import DataLoader

from doughdata.torch import DoughDataset


def main(dataset: str) -> float:
    """A small occupancy network: is a query point inside dough, given the points that are seen?"""
    loader = DataLoader(
        DoughDataset(dataset, num_points=256, num_queries=256), batch_size=2, num_workers=2
    )
    encode = nn.Sequential(nn.Linear(3, 32), nn.ReLU(), nn.Linear(32, 32))
    decode = nn.Sequential(nn.Linear(35, 32), nn.ReLU(), nn.Linear(32, 1))
    optimiser = torch.optim.AdamW([*encode.parameters(), *decode.parameters()], lr=1e-3)
    batch = next(iter(loader))
    code = encode(batch["points"]).amax(dim=1, keepdim=True)  # (batch, 1, 32)
    queries = batch["queries"]
    logits = decode(torch.cat([queries, code.expand(-1, queries.shape[1], -1)], dim=-1))[..., 0]
    inside = (batch["query_labels"] < batch["num_components"][:, None]).float()
    loss = nn.functional.binary_cross_entropy_with_logits(logits, inside)
    loss.backward()
    optimiser.step()
    print(f"loss {loss.item():.3f}")
    return loss.item()


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "dough-dataset")
