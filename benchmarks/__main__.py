"""``python -m benchmarks`` lists what can be measured."""

print(
    """python -m benchmarks.accuracy [NAME ...]   errors of recipes side by side; finished cells are kept
python -m benchmarks.speed                 training and prediction against the machine's own peak

Real data is looked for in UPLIFT_DATA. Results go to benchmarks/results/."""
)
