"""The same network, data and steps in PyTorch: `python -m agile_jax.benchmark.peers.torch_peer WORKLOAD.npz`.

A process of its own, so that neither framework's threads get in the other's way. For each line on its standard input,
the name of a precision, it does the steps from the beginning and answers with one line of JSON: wall and processor
seconds, and the losses. float32 is PyTorch as it comes; bfloat16 its autocast. `products` multiplies two matrices at
the shape of the widest layer.
"""

import json
import sys
import time

import numpy as np


def main(path: str) -> None:
    """Answer until the input ends."""
    import torch

    data = np.load(path)
    count = int(data["layers"])
    rows, poses, labels = (torch.from_numpy(data[name]) for name in ("rows", "poses", "labels"))
    parameters = [(data[f"kernel_{i}"], data[f"bias_{i}"]) for i in range(count)]
    layers: list[object] = []
    for kernel, _ in parameters:
        layers += [torch.nn.Linear(*kernel.shape), torch.nn.Tanh()]
    network = torch.nn.Sequential(*layers[:-1])
    optimizer = torch.optim.SGD(network.parameters(), lr=float(data["learning_rate"]))
    wide = torch.from_numpy(max((kernel for kernel, _ in parameters), key=np.size))
    batch = torch.randn(rows.shape[1], wide.shape[0])

    def reset() -> None:
        with torch.no_grad():
            for layer, (kernel, bias) in zip(network[::2], parameters, strict=True):
                layer.weight.copy_(torch.from_numpy(kernel.T.copy()))
                layer.bias.copy_(torch.from_numpy(bias))

    def steps(bfloat16: bool) -> list[float]:
        losses = []
        for row in rows:
            x, y = poses[row], labels[row]
            optimizer.zero_grad(set_to_none=True)
            with torch.autocast("cpu", torch.bfloat16, enabled=bfloat16):
                found = network(x)
            loss = ((found.float() - y) ** 2).mean()
            loss.backward()
            optimizer.step()
            losses.append(loss.detach())
        return [float(loss) for loss in losses]

    for line in sys.stdin:
        name, losses = line.strip(), []
        reset()
        wall, cpu = time.perf_counter(), time.process_time()
        if name == "products":
            torch.matmul(batch, wide)
        else:
            losses = steps(name == "bfloat16")
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        answer = {"wall": wall, "cpu": cpu, "losses": losses, "threads": torch.get_num_threads()}
        print(json.dumps(answer | {"version": torch.__version__}), flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
