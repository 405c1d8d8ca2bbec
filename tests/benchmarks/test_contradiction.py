from benchmarks.contradiction import FocalTrial, focal_table


def trial(factor, *, tracked=1.0, better=None, reason=None):
    other = None if better is None else {"agreement": 0.3, "better": better, "focal_ratio": factor, "gripper_m": 0.2}
    return FocalTrial(id="a", factor=factor, tracked=tracked, agreement=0.4, contradiction=other, reason=reason)


def test_a_camera_is_noticed_where_the_row_says_that_the_arm_contradicts_it():
    lost = trial(0.7, tracked=None, reason="the gripper was found in 0 of 9 frames")
    said = trial(0.7, tracked=None, reason="not its camera: the arm contradicts the camera of the input")
    trials = [trial(1.0), trial(0.7, better=0.7, reason="no base frame"), lost, said, trial(0.7)]
    assert [t.is_noticed for t in trials] == [False, True, False, True, False]
    assert [FocalTrial.from_json(t.to_json()) for t in trials] == trials
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in focal_table(trials)[2:]]
    assert rows == [["0.7", "4", "2", "1", "2"], ["1", "1", "0", "1", "0"]]
