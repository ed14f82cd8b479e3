"""The paper's deep network trained by JAX on the CPU: the yardstick for `tactus-lab train dnn`.

usage: python3 deep_reference.py [STEPS] [THREADS]     (pip install "jax[cpu]")

Prints samples a second, the best and the median step of a batch of 128. Data are random: their values do not change the
time. Without JAX it says so and ends well.
"""

import os
import sys
import time

steps = int(sys.argv[1]) if len(sys.argv) > 1 else 20
threads = int(sys.argv[2]) if len(sys.argv) > 2 else 2
os.environ["XLA_FLAGS"] = f"--xla_cpu_multi_thread_eigen=true intra_op_parallelism_threads={threads}"
try:
    import jax
    import jax.numpy as jnp
    import numpy as np
except ImportError as reason:
    print(f"skipped: {reason}")
    sys.exit(0)

BATCH = 128
sizes = [598, 2048, 2048, 2048, 2048, 3690]
key = jax.random.PRNGKey(0)
params = []
for a, b in zip(sizes, sizes[1:]):
    key, sub = jax.random.split(key)
    limit = (6 / (a + b)) ** 0.5
    params.append((jax.random.uniform(sub, (a, b), jnp.float32, -limit, limit), jnp.zeros(b)))


def loss(params, x, y):
    x = (x - x.mean(0)) / jnp.sqrt(x.var(0) + 1e-5)
    for weights, bias in params[:-1]:
        x = jax.nn.elu(x @ weights + bias)
    weights, bias = params[-1]
    return 0.5 * ((x @ weights + bias - y) ** 2).sum() / BATCH


def step(params, first, second, number, x, y):
    value, gradient = jax.value_and_grad(loss)(params, x, y)
    first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, first, gradient)
    second = jax.tree.map(lambda v, g: 0.999 * v + 0.001 * g * g, second, gradient)
    rate = 1e-3 * jnp.sqrt(1 - 0.999**number) / (1 - 0.9**number)
    params = jax.tree.map(lambda p, m, v: p - rate * m / (jnp.sqrt(v) + 1e-8), params, first, second)
    return params, first, second, value


step = jax.jit(step, donate_argnums=(0, 1, 2))
first = jax.tree.map(jnp.zeros_like, params)
second = jax.tree.map(jnp.zeros_like, params)
x = jnp.array(np.random.randn(BATCH, sizes[0]).astype(np.float32))
y = jnp.array(np.random.rand(BATCH, sizes[-1]).astype(np.float32))
times = []
for number in range(1, steps + 1):
    start = time.perf_counter()
    params, first, second, value = step(params, first, second, jnp.float32(number), x, y)
    jax.block_until_ready((params, value))
    times.append(time.perf_counter() - start)
times = sorted(times[2:])
print(f"jax {jax.__version__}, {threads} threads: best {BATCH / times[0]:.0f}, median {BATCH / times[len(times) // 2]:.0f} samples/s")
