"""placeholder"""


def score_2d(model, data):
    return {}
