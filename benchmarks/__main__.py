"""``python -m benchmarks`` lists the benchmarks."""

print(
    """python -m benchmarks.accuracy [TABLE ...]  errors of recipes side by side
python -m benchmarks.examples [--only X]   the files of docs/examples.md on real data, compared with flat depth
python -m benchmarks.lifters [NAME ...]    the ready lifters: fit, measure, write weights and model cards
python -m benchmarks.speed                 training and prediction, relative to the machine's peak
python -m benchmarks.loading               a data set of Human3.6M's size: loading, memory, training speed
python -m benchmarks.reading               reading a million bodies in each format, writing predictions in each
python -m benchmarks.quadruped_masks       animals with missing joints: what masks add to keypoints
python -m benchmarks.shapes COMMAND ...    shapes from masks: demo, families, twin, semi, animals, cost
python -m benchmarks.mutation [MODULES]    which share of small bugs the tests notice, module by module
python -m benchmarks.settings_tables       the tables of settings in the documentation, from the code (make docs)
python -m benchmarks.ground RUN FILE ...  what ground=true changes: sliding feet, the path of the root, poses
python -m benchmarks.opensim RUN           inverse kinematics of lifted people: errors of markers, knees and elbows
python -m benchmarks.transfer [--only X]   fits of new data from scratch and from a ready lifter (init=)
python -m benchmarks.score_2d [FAMILY ...] how well figures without truth order lifters as their errors do

Real data is read from UPLIFT_DATA. Results are stored in benchmarks/results/; stored results are not computed again."""
)
