"""``python -m benchmarks`` lists what can be measured."""

print(
    """python -m benchmarks.accuracy [NAME ...]   errors of recipes side by side; finished cells are kept
python -m benchmarks.examples [--only X]   the files of docs/examples.md on real sets, beside flat depth
python -m benchmarks.speed                 training and prediction against the machine's own peak
python -m benchmarks.loading               a data set of Human3.6M's size: loading, memory, training
python -m benchmarks.reading               a million bodies read in each format, predictions written in each
python -m benchmarks.quadruped_masks       animals with joints missing: what masks of them add to keypoints
python -m benchmarks.shapes COMMAND ...    shapes lifted from masks: demo, families, twin, semi, animals, cost
python -m benchmarks.paper_tables [NAME]   Tables 1 and 2 and the 3DHP figure of Kudo et al. 2018, with your data

Real data is looked for in UPLIFT_DATA. Results go to benchmarks/results/."""
)
