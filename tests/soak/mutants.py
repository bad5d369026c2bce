"""Faults put into the verdict one by one; of each the test that is meant to catch it must fail.

Catches a test that no longer sees the fault it is there for: a threshold that is crossed by
touching it, a sign, an order of steps, earlier and later swapped. The tests run on a copy of the
tracked files in a temporary folder; the working tree is not touched.

    python tests/soak/mutants.py            # all, some 8 s each
    python tests/soak/mutants.py --few      # the first five
    python tests/soak/mutants.py --only 12  # one, by its number

Exit code: 0 if all are killed, 1 if one survives, 2 if the list or the tests don't fit the code.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
FEW = 5
DECIDE, DRAWS = "dgeval/verdict/decide.py", "dgeval/verdict/draws.py"
GEOMETRIC, JUDGE = "dgeval/verdict/geometric.py", "dgeval/verdict/judge.py"
LIFT, TEST_LIFT = "dgeval/worlds/hand_and_object.py", "tests/worlds/test_close_and_lift.py"
OUTCOME, PICTURE = "dgeval/verdict/outcome.py", "dgeval/verdict/picture.py"
SENTENCE, RULE = "dgeval/verdict/sentence.py", "dgeval/failure_rule.py"
TEST_BLAME, TEST_DECIDE = "tests/verdict/test_blame.py", "tests/verdict/test_decide.py"
TEST_OUTCOME, TEST_PICTURE = "tests/verdict/test_outcome.py", "tests/verdict/test_picture.py"
TEST_SENTENCE, TEST_TABLE = "tests/verdict/test_sentence.py", "tests/verdict/test_sub_causes.py"
CLOSES, TEST_CLOSES = "dgeval/recording/closes.py", "tests/recording/test_closes.py"
MOTION = "dgeval/recording/closing_motion.py"
CAMERAS, CHECKS = "dgeval/recording/cameras.py", "dgeval/recording/checks.py"
MODEL_TRACKER = "dgeval/perception/trackers/model.py"
TEST_LOOKS = "tests/perception/test_looks.py"
TEST_CHECKS = "tests/recording/test_checks.py"
TEST_TARGET = "tests/recording/test_recorded_target.py"
TEST_ESTIMATES = "tests/verdict/test_estimates.py"
TEST_ROBOTS = "tests/recording/test_several_robots.py"
TEST_RULE, TEST_LINES = "tests/test_failure_rule.py", "tests/test_failure_rule_lines.py"


class Mutant(NamedTuple):
    """A fault: `old`, which stands once in the file, becomes `new`; the test that must fail."""

    file: str
    old: str
    new: str
    test: str


MUTANTS = [
    # the first FEW: a threshold, an order of steps, a vote, a sign, a sentence
    Mutant(
        RULE,
        "facts.displacement_m > th.moved_m",
        "facts.displacement_m >= th.moved_m",
        f"{TEST_LINES}::test_moved_is_strictly_more_than_5_mm_or_5_degrees",
    ),
    Mutant(
        DECIDE,
        "if share < TRUSTED:",
        "if share < TRUSTED and p >= min_probability:",
        f"{TEST_DECIDE}::test_doubts_come_in_the_order_instrument_collision_probability",
    ),
    Mutant(
        DECIDE,
        "votes = [sum(weight for name, weight in said if name == c)",
        "votes = [sum(1 for name, weight in said if name == c)",
        f"{TEST_DECIDE}::test_votes_are_weighted_by_how_well_a_draw_agrees_with_the_log",
    ),
    Mutant(
        DRAWS,
        "key=lambda k: -weights[k]",
        "key=lambda k: weights[k]",
        f"{TEST_DECIDE}::test_the_draws_that_agree_best_are_asked_first",
    ),
    Mutant(
        SENTENCE,
        '"earlier" if shift < 0 else "later"',
        '"later" if shift < 0 else "earlier"',
        f"{TEST_SENTENCE}::test_timing_of_a_hand_that_closed",
    ),
    # the failure rule
    Mutant(
        RULE,
        "facts.displacement_deg > th.moved_deg",
        "facts.displacement_deg >= th.moved_deg",
        f"{TEST_LINES}::test_moved_is_strictly_more_than_5_mm_or_5_degrees",
    ),
    Mutant(
        RULE,
        "facts.height_m >= th.unstable_m",
        "facts.height_m > th.unstable_m",
        f"{TEST_LINES}::test_from_20_mm_on_it_was_lifted_and_lost",
    ),
    Mutant(
        RULE,
        "if facts.overlap_m <= th.overlap_m:",
        "if facts.overlap_m < th.overlap_m:",
        f"{TEST_LINES}::test_up_to_2_mm_of_overlap_the_object_put_back_is_believed",
    ),
    Mutant(
        RULE,
        "c[0] <= facts.contact_s",
        "c[0] < facts.contact_s",
        f"{TEST_LINES}::test_a_close_at_the_last_tick_before_contact_counts_as_before_it",
    ),
    Mutant(
        RULE,
        "earlier = nearest_run(before, th.consecutive)",
        "earlier = nearest_run(facts.curve, th.consecutive)",
        f"{TEST_RULE}::test_overlap_proves_nothing",
    ),
    Mutant(
        RULE,
        "shift is not None and shift > 0,",
        "shift is not None and shift < 0,",
        f"{TEST_RULE}::test_two_other_closes_in_a_row_are_timing",
    ),
    Mutant(
        RULE,
        "lambda facts, shift, th: not facts.closed,",
        "lambda facts, shift, th: facts.closed,",
        f"{TEST_RULE}::test_never_closed",
    ),
    Mutant(
        RULE,
        "lambda facts, shift, th: facts.height_m >= th.unstable_m,",
        "lambda facts, shift, th: True,",
        f"{TEST_TABLE}::test_every_row_is_reached",
    ),
    Mutant(  # step 1: a push asked before another close
        RULE,
        "if shift is not None:\n",
        "if shift is not None and not moved:\n",
        f"{TEST_LINES}::test_a_hand_that_never_closed_is_first_asked_for_another_close",
    ),
    Mutant(  # step 4 before 2 and 3
        RULE,
        "    if moved:",
        "    if moved and shift is None:",
        f"{TEST_RULE}::test_a_push_is_a_collision_only_if_it_mattered",
    ),
    Mutant(
        RULE,
        "parted = bool(run) and run[-1] < 0 < offset",
        "parted = False",
        f"{TEST_LINES}::test_the_nearest_close_of_a_run",
    ),
    Mutant(
        RULE,
        "nearest = min(run, key=abs)",
        "nearest = max(run, key=abs)",
        f"{TEST_LINES}::test_the_nearest_close_of_a_run",
    ),
    Mutant(
        RULE,
        "len(run) >= consecutive",
        "len(run) > consecutive",
        f"{TEST_LINES}::test_how_many_closes_make_a_run_is_a_setting",
    ),
    Mutant(
        RULE,
        "HANDED_OVER = Thresholds(moved_m=0.012)",
        "HANDED_OVER = Thresholds()",
        f"{TEST_LINES}::test_a_handed_over_object_may_give_way_by_12_mm",
    ),
    # the decision: steps 1 to 5
    Mutant(
        DECIDE,
        "if sd_m > BLIND_SD_M:",
        "if sd_m >= BLIND_SD_M:",
        f"{TEST_DECIDE}::test_a_place_that_is_not_known_asks_no_instrument",
    ),
    Mutant(
        DECIDE,
        "if share < TRUSTED:",
        "if share < 2 * TRUSTED:",
        f"{TEST_DECIDE}::test_an_instrument_that_hardly_ever_fails_is_not_trusted",
    ),
    Mutant(  # 4b before 4a
        DECIDE,
        "if share < TRUSTED:",
        'if share < TRUSTED and best != "collision":',
        f"{TEST_DECIDE}::test_doubts_come_in_the_order_instrument_collision_probability",
    ),
    Mutant(
        DECIDE,
        'if best == "collision" and share < RARELY:',
        'if best == "collision" and share <= RARELY:',
        f"{TEST_DECIDE}::test_a_collision_needs_a_failure_in_a_quarter_of_the_draws",
    ),
    Mutant(
        DECIDE,
        'if best == "collision" and share < RARELY:',
        "if share < RARELY:",
        f"{TEST_DECIDE}::test_a_rare_failure_of_another_class_is_believed",
    ),
    Mutant(  # 4c before 4b
        DECIDE,
        'if best == "collision" and share < RARELY:',
        'if best == "collision" and share < RARELY and p >= min_probability:',
        f"{TEST_DECIDE}::test_doubts_come_in_the_order_instrument_collision_probability",
    ),
    Mutant(
        DECIDE,
        "if p < min_probability:",
        "if p <= least:",
        f"{TEST_DECIDE}::test_a_class_must_be_as_likely_as_asked",
    ),
    Mutant(
        DECIDE,
        "PRIOR = 0.15",
        "PRIOR = 0.0",
        f"{TEST_DECIDE}::test_a_class_must_be_as_likely_as_asked",
    ),
    Mutant(
        DECIDE,
        "(float(share) * (1 - unknown) for share in p)",
        "(float(share) for share in p)",
        f"{TEST_DECIDE}::test_of_an_unknown_class_the_probabilities_are_halved",
    ),
    Mutant(
        DECIDE,
        "best = int(np.argmax(p))",
        "best = int(np.argmin(p))",
        f"{TEST_DECIDE}::test_draws_that_agree_give_their_class",
    ),
    Mutant(
        DECIDE,
        "lead = max(chosen, key=lambda d: d.reproduced).verdict",
        "lead = chosen[0].verdict",
        f"{TEST_DECIDE}::test_the_sub_cause_is_that_of_a_draw_that_ends_as_recorded",
    ),
    Mutant(
        DECIDE,
        "for d in chosen if d.verdict.sub_cause == lead.sub_cause]",
        "for d in chosen]",
        f"{TEST_DECIDE}::test_the_shift_is_the_median_over_draws_of_the_same_sub_cause",
    ),
    Mutant(
        DECIDE,
        "float(np.median(shifts))",
        "float(np.mean(shifts))",
        f"{TEST_DECIDE}::test_the_shift_is_the_median_over_draws_of_the_same_sub_cause",
    ),
    Mutant(
        DECIDE,
        "if d.verdict.failure_class == self.answer.failure_class]",
        "]",
        f"{TEST_BLAME}::test_only_draws_of_the_class_are_asked",
    ),
    # blame: step 6
    Mutant(  # 6.2 before 6.1
        DECIDE,
        "if isinstance(answer, Unknown):  # 6.1",
        "if isinstance(answer, Unknown) and not isinstance(beliefs, Unknown):  # 6.1",
        f"{TEST_BLAME}::test_an_unknown_class_has_no_part_to_blame",
    ),
    Mutant(
        DECIDE,
        'if answer.sub_cause == "early":',
        'if answer.sub_cause == "late":',
        f"{TEST_BLAME}::test_a_hand_that_closed_early_is_off_its_grasp_because_of_that",
    ),
    Mutant(
        DECIDE,
        "if shares[part] > ENOUGH]",
        "if shares[part] >= ENOUGH]",
        f"{TEST_BLAME}::test_half_of_the_draws_are_not_enough",
    ),
    Mutant(
        DECIDE,
        "if sizes[p] > TOLERANCE_M)",
        "if sizes[p] > 0.0)",
        f"{TEST_BLAME}::test_a_part_within_what_grasps_survive_is_not_blamed",
    ),
    Mutant(
        DECIDE,
        "if wrong_law(beliefs) and not huge and all(",
        "if wrong_law(beliefs) and all(",
        f"{TEST_BLAME}::test_a_wrong_law_does_not_hide_a_huge_error",
    ),
    Mutant(  # 6.5 before 6.6 whatever restores success
        DECIDE,
        "all(sizes[p] < SMALL * TOLERANCE_M for p in restoring)",
        "True",
        f"{TEST_BLAME}::"
        "test_a_wrong_law_does_not_hide_a_part_that_restores_and_is_twice_the_tolerance",
    ),
    Mutant(
        DECIDE,
        "_stands_out(restoring, sizes, CLEARLY)",
        "_stands_out(restoring, sizes, CLEARLY_ALL)",
        f"{TEST_BLAME}::test_of_two_that_would_do_the_one_half_as_large_again",
    ),
    Mutant(
        DECIDE,
        "_stands_out(large, sizes, CLEARLY_ALL)",
        "_stands_out(large, sizes, CLEARLY)",
        f"{TEST_BLAME}::test_where_only_all_together_restore_one_must_be_twice_the_next",
    ),
    Mutant(  # 6.7 before 6.6
        DECIDE,
        "if _stands_out(restoring, sizes, CLEARLY):",
        "if _stands_out(restoring, sizes, CLEARLY) and large[0] == restoring[0]:",
        f"{TEST_BLAME}::test_the_largest_may_be_blamed_though_smaller_ones_restore_alone",
    ),
    Mutant(  # 6.8 before 6.7
        DECIDE,
        'if shares["all"] > ENOUGH and _stands_out(',
        'if not restoring and shares["all"] > ENOUGH and _stands_out(',
        f"{TEST_BLAME}::test_the_largest_may_be_blamed_though_smaller_ones_restore_alone",
    ),
    Mutant(  # 6.10 before 6.8
        DECIDE,
        "if restoring:  # 6.8",
        'if restoring and answer.failure_class != "timing":  # 6.8',
        f"{TEST_BLAME}::test_a_part_that_restores_a_timing_failure_goes_before_execution",
    ),
    Mutant(  # 6.10 before 6.9
        DECIDE,
        "if huge:  # 6.9",
        'if huge and answer.failure_class != "timing":  # 6.9',
        f"{TEST_BLAME}::test_a_huge_error_is_blamed_before_execution",
    ),
    Mutant(  # 6.11 before 6.10
        DECIDE,
        'if answer.failure_class == "timing":  # 6.10',
        'if answer.failure_class == "timing" and not large:  # 6.10',
        f"{TEST_BLAME}::test_a_close_at_the_wrong_time_is_executions",
    ),
    Mutant(
        DECIDE,
        "abs(answer.shift_s or 0.0)",
        "(answer.shift_s or 0.0)",
        f"{TEST_BLAME}::test_a_close_at_the_wrong_time_is_executions",
    ),
    Mutant(
        DECIDE,
        "1.0 - max(shares.values())",
        "1.0",
        f"{TEST_BLAME}::test_where_no_part_is_off_what_the_robot_was_after_fails_too",
    ),
    Mutant(
        DECIDE,
        "level, upright = beliefs.gains",
        "upright, level = beliefs.gains",
        f"{TEST_BLAME}::test_what_counts_as_a_wrong_law",
    ),
    Mutant(
        DECIDE,
        "not 1 / GAINS_APART < upright / level < GAINS_APART",
        "upright / level >= GAINS_APART",
        f"{TEST_BLAME}::test_what_counts_as_a_wrong_law",
    ),
    Mutant(
        DECIDE,
        'if sizes["servo"] <= TOLERANCE_M and goal > ENOUGH:',
        "if goal > ENOUGH:",
        f"{TEST_BLAME}::test_never_closed_and_not_at_its_grasp_is_not_executions",
    ),
    Mutant(  # 6.4b before 6.4a
        DECIDE,
        'if sizes["servo"] <= TOLERANCE_M and goal > ENOUGH:',
        'if not off and sizes["servo"] <= TOLERANCE_M and goal > ENOUGH:',
        f"{TEST_BLAME}::test_never_closed_at_a_grasp_that_would_have_held_is_executions",
    ),
    Mutant(
        DECIDE,
        "if sizes.get(part, 0.0) > NEVER_CLOSED_M]",
        "if sizes.get(part, 0.0) > TOLERANCE_M]",
        f"{TEST_BLAME}::test_never_closed_the_one_part_that_is_off",
    ),
    Mutant(
        DECIDE,
        'if sizes["servo"] <= TOLERANCE_M and beliefs.goal is not None:',
        'if sizes["servo"] <= TOLERANCE_M:',
        f"{TEST_BLAME}::test_never_closed_at_a_grasp_that_would_not_have_held_is_synthesis",
    ),
    # the draws
    Mutant(
        DRAWS,
        "[: max(MOST, draws)]",
        "[:MOST]",
        f"{TEST_DECIDE}::test_how_many_draws_are_asked",
    ),
    Mutant(
        DRAWS,
        "off - off.min(axis=0)",
        "off",
        f"{TEST_DECIDE}::test_disagreement_is_measured_from_the_best_draw",
    ),
    Mutant(
        DRAWS,
        "wider = 1.0 if k < PROBES // 2 else 2.0",
        "wider = 1.0",
        f"{TEST_DECIDE}::test_how_widely_the_draws_are_spread",
    ),
    Mutant(
        DRAWS,
        "np.radians(float(np.clip(scene.sd_deg, SD_LEAST_DEG, SD_MOST_DEG)))",
        "float(np.clip(scene.sd_deg, SD_LEAST_DEG, SD_MOST_DEG))",
        f"{TEST_DECIDE}::test_how_widely_the_draws_are_spread",
    ),
    Mutant(
        DRAWS,
        "if k == 0:  # the first",
        "if k == 1:  # the first",
        f"{TEST_DECIDE}::test_the_first_draw_is_the_best_guess_and_the_others_are_repeatable",
    ),
    Mutant(
        DRAWS,
        "[1.0 if reproduced else NOT_REPRODUCED for",
        "[1.0 for",
        f"{TEST_DECIDE}::test_draws_without_the_failure_count_0_3",
    ),
    Mutant(
        DRAWS,
        "sum(reproduced for _, reproduced in probes) / len(probes)",
        "sum(d.reproduced for d in asked) / len(asked)",
        f"{TEST_DECIDE}::test_a_rare_failure_of_another_class_is_believed",
    ),
    Mutant(
        DRAWS,
        "thresholds = HANDED_OVER if scene.held else Thresholds()",
        "thresholds = Thresholds()",
        f"{TEST_DECIDE}::test_a_held_object_has_its_own_thresholds_and_solid",
    ),
    Mutant(
        DRAWS,
        "except (ValueError, QhullError) as error:",
        "except KeyError as error:",
        f"{TEST_DECIDE}::test_a_cloud_without_a_solid_has_no_decision_and_says_why",
    ),
    # geometry alone
    Mutant(
        GEOMETRIC,
        "real[k] = free[k] + (off_path",
        "real[k] = free[k] - (off_path",
        f"{TEST_DECIDE}::test_geometry_a_pushed_object_that_the_hand_would_have_missed_anyway",
    ),
    Mutant(
        GEOMETRIC,
        "- real[end] - scene.velocity * dt",
        "- real[end] + scene.velocity * dt",
        f"{TEST_DECIDE}::test_geometry_a_belt_carries_the_object_to_and_from_a_waiting_hand",
    ),
    Mutant(
        GEOMETRIC,
        "gap = places[end] + velocity * dt",
        "gap = places[end] - velocity * dt",
        f"{TEST_DECIDE}::test_geometry_early",
    ),
    Mutant(
        GEOMETRIC,
        "ok = bool(np.linalg.norm(places[end] - free[end]) < REACH_M)",
        "ok = bool(np.linalg.norm(places[end] - real[end]) < REACH_M)",
        f"{TEST_DECIDE}::test_geometry_a_pushed_object_that_would_have_been_in_the_grasp",
    ),
    Mutant(
        GEOMETRIC,
        "if np.linalg.norm(places[k] - real_now) < NEAR_M:",
        "if True:",
        f"{TEST_DECIDE}::test_geometry_a_sighting_off_the_path_far_from_the_hand_is_no_push",
    ),
    Mutant(
        GEOMETRIC,
        "float(np.sort(off[:, 0])[-3:].min())",
        "float(off[:, 0].max())",
        f"{TEST_DECIDE}::test_geometry_two_sightings_alone_are_no_push",
    ),
    # the sentence and the row
    Mutant(
        SENTENCE,
        "+ round(shift_s * 1e9)",
        "- round(shift_s * 1e9)",
        f"{TEST_SENTENCE}::test_timing_of_a_hand_that_closed",
    ),
    Mutant(
        SENTENCE,
        "(self.last_ns if self.close_ns is None else self.close_ns)",
        "(self.close_ns or self.first_ns)",
        f"{TEST_SENTENCE}::test_timing_of_a_hand_that_never_closed",
    ),
    Mutant(
        SENTENCE,
        "facts.displacement_m > PUSHED_TOO_M",
        "facts.displacement_m >= PUSHED_TOO_M",
        f"{TEST_SENTENCE}::test_imprecise_pose",
    ),
    Mutant(
        SENTENCE,
        "max(decision.probabilities)",
        "decision.probabilities[0]",
        f"{TEST_SENTENCE}::test_timing_of_a_hand_that_closed",
    ),
    Mutant(
        RULE,
        '"The object was lifted and slipped; ',
        '"The object was not in the grasp; ',
        f"{TEST_SENTENCE}::test_imprecise_pose",
    ),
    Mutant(
        JUDGE,
        "hindsight.pushed_ns or hindsight.contact_ns",
        "hindsight.contact_ns or hindsight.pushed_ns",
        f"{TEST_SENTENCE}::test_collision",
    ),
    Mutant(
        JUDGE,
        "return times.pushed_ns or times.close_ns",
        "return times.close_ns",
        f"{TEST_SENTENCE}::test_the_decisive_moment_of_a_collision",
    ),
    Mutant(
        JUDGE,
        "Times(log.first_ns, ",
        "Times(log.first_ns - 10**9, ",
        f"{TEST_SENTENCE}::test_collision",
    ),
    Mutant(
        JUDGE,
        "max(names, key=lambda name: weight[name]) if names else None",
        "names[0] if names else None",
        f"{TEST_SENTENCE}::test_the_link_that_most_draws_name",
    ),
    Mutant(
        JUDGE,
        "p_blame=None if isinstance(blame.part, Unknown) else blame.probability",
        "p_blame=blame.probability",
        f"{TEST_SENTENCE}::test_the_row_of_a_doubt",
    ),
    # how it ended, and the picture
    Mutant(
        OUTCOME,
        "if after_s < (AFTER_S if",
        "if after_s <= (AFTER_S if",
        f"{TEST_OUTCOME}::test_from_one_second_on_the_fingers_are_at_rest",
    ),
    Mutant(
        "dgeval/verdict/log.py",
        "label = trial.spec.label or trial.events.label()",
        "label = trial.events.label()",
        f"{TEST_OUTCOME}::test_the_manifests_label_goes_before_the_logs",
    ),
    Mutant(
        "dgeval/robots/dlr_hit_hand.py",
        "if pressing >= 2:",
        "if pressing >= 1:",
        f"{TEST_OUTCOME}::test_two_fingers_with_more_than_0_05_nm_hold",
    ),
    Mutant(
        "dgeval/robots/dlr_hit_hand.py",
        "np.abs(np.mean(efforts, axis=0))",
        "np.mean(np.abs(efforts), axis=0)",
        f"{TEST_OUTCOME}::test_efforts_are_judged_by_their_mean_over_the_last_half_second",
    ),
    Mutant(
        "dgeval/robots/parallel_jaw.py",
        "positions.sum(axis=1)",
        "positions.max(axis=1)",
        f"{TEST_OUTCOME}::test_jaws_hold_what_keeps_them_2_mm_apart",
    ),
    Mutant(
        OUTCOME,
        "fingers[0] != seen[0]",
        "fingers[0] == seen[0]",
        f"{TEST_OUTCOME}::test_fingers_and_sightings_together",
    ),
    Mutant(
        OUTCOME,
        "confident if held else 1 - confident",
        "confident",
        f"{TEST_OUTCOME}::test_fingers_and_sightings_together",
    ),
    Mutant(
        OUTCOME,
        "if rise < LEFT_BEHIND_M:",
        "if rise > LEFT_BEHIND_M:",
        f"{TEST_OUTCOME}::test_an_object_left_on_its_support",
    ),
    Mutant(
        OUTCOME,
        "near[0] < AWAY_M",
        "near[0] < IN_HAND_M",
        f"{TEST_OUTCOME}::test_an_object_up_with_the_hand",
    ),
    Mutant(
        OUTCOME,
        "rise = float(np.median(rises))",
        "rise = float(np.mean(rises))",
        f"{TEST_OUTCOME}::test_how_high_it_is_follows_the_median",
    ),
    Mutant(
        PICTURE,
        "transform(T_camera_base @ hindsight.path.at(t_ns), hindsight.points)",
        "transform(T_base_camera @ hindsight.path.at(t_ns), hindsight.points)",
        f"{TEST_PICTURE}::test_the_camera_moves_the_picture",
    ),
    Mutant(
        LIFT,
        "return True if self._periods >= self._held else None",
        "return True",
        f"{TEST_LIFT}::test_what_is_held_for_a_second_after_the_lift_is_a_success",
    ),
    Mutant(
        LIFT,
        "if not self._in_hand():",
        "if self._periods >= self._held and not self._in_hand():",
        f"{TEST_LIFT}::test_one_period_without_any_of_the_conditions_is_a_failure",
    ),
    Mutant(
        LIFT,
        "or not w.touch().object or w.held_by_presenter",
        "or w.held_by_presenter",
        f"{TEST_LIFT}::test_one_period_without_any_of_the_conditions_is_a_failure",
    ),
    Mutant(
        LIFT,
        "or not w.touch().object or w.held_by_presenter",
        "or not w.touch().object",
        f"{TEST_LIFT}::test_a_person_lets_go_of_what_two_fingers_have_pressed_for_a_moment",
    ),
    Mutant(
        LIFT,
        "self._object()[2] if world.held_by_presenter else world.rest",
        "world.rest",
        f"{TEST_LIFT}::test_what_was_presented_must_rise_above_where_it_was_at_the_close",
    ),
    Mutant(
        LIFT,
        "self._gripped_s + CONTROL_S if gripped else 0.0",
        "self._gripped_s + CONTROL_S * gripped",
        f"{TEST_LIFT}::test_a_person_lets_go_of_what_two_fingers_have_pressed_for_a_moment",
    ),
    Mutant(
        LIFT,
        "self._periods > self._given_up and ",
        "",
        f"{TEST_LIFT}::test_what_is_left_behind_is_given_up_early",
    ),
    Mutant(
        MOTION,
        "if lift is None or lift - start < BEFORE_LIFT_NS:",
        "if lift is None or lift - end < BEFORE_LIFT_NS:",
        f"{TEST_CLOSES}::test_a_lift_right_behind_a_slow_close",
    ),
    Mutant(
        MOTION,
        "for k in reversed(range(len(motions))):",
        "for k in range(len(motions)):",
        f"{TEST_CLOSES}::test_the_last_of_two_attempts_counts",
    ),
    Mutant(
        MOTION,
        "if begin - rest_ns > AFTER_S * 1e9 or heights",
        "if heights",
        f"{TEST_CLOSES}::test_a_lift_long_after_is_not_of_this_close",
    ),
    Mutant(
        MOTION,
        "start - motions[k - 1][1] < RESTING_NS",
        "False",
        f"{TEST_CLOSES}::test_fingers_that_pause_at_the_object_close_once",
    ),
    Mutant(
        CAMERAS,
        "            stereo,\n            not aligned,\n",
        "            not aligned,\n            stereo,\n",
        f"{TEST_CHECKS}::test_colour_that_can_be_aligned_goes_before_aligned_infrared",
    ),
    Mutant(
        CAMERAS,
        "(not one_frame, not same_size, -shared, name)",
        "(not one_frame, -shared, not same_size, name)",
        f"{TEST_CHECKS}::test_intrinsics_of_the_pictures_size_go_before_those_of_a_nearer_name",
    ),
    Mutant(
        CAMERAS,
        "(near and model.frame_id not in _frames(heads))",
        "near",
        f"{TEST_CHECKS}::test_intrinsics_of_another_picture_are_not_taken_for_their_name",
    ),
    Mutant(
        CHECKS,
        "known < LEAST_POSES * len(times)",
        "known < 0.1 * LEAST_POSES * len(times)",
        f"{TEST_CHECKS}::test_poses_in_fewer_than_half_of_the_frames_fail",
    ),
    Mutant(
        "dgeval/recording/clock_checks.py",
        'side = "behind" if apart > 0',
        'side = "behind" if apart < 0',
        f"{TEST_CHECKS}::test_the_mend_of_a_clock_mends_it",
    ),
    Mutant(
        "dgeval/recording/stamp_checks.py",
        "lost > MOST_DROPPED * count",
        "lost > 9 * MOST_DROPPED * count",
        f"{TEST_CHECKS}::test_stamps_that_cost_a_tenth_of_a_stream_fail",
    ),
    Mutant(
        "dgeval/recording/clock_checks.py",
        "max(robots.items(), key=lambda",
        "min(robots.items(), key=lambda",
        f"{TEST_CHECKS}::test_the_robots_topic_that_is_farthest_off_counts",
    ),
    Mutant(
        "dgeval/recording/alignment.py",
        "or nearness < out[row, column]",
        "or nearness > out[row, column]",
        f"{TEST_CHECKS}::test_what_is_nearer_hides_what_is_behind_it",
    ),
    Mutant(
        "dgeval/recording/clocks.py",
        "np.where(zero, log_ns, header_ns) + offset_ns",
        "np.where(zero, log_ns, header_ns + offset_ns)",
        f"{TEST_CHECKS}::test_a_zero_stamp_gets_the_offset_too",
    ),
    # what a stranger's log may hold
    Mutant(
        RULE,
        "nearest_m < NEAR_M:",
        "nearest_m <= 2 * NEAR_M:",
        f"{TEST_OUTCOME}::test_near_and_never_closed_is_a_failure",
    ),
    Mutant(
        RULE,
        "if nearest_m is None and moved:",
        "if nearest_m is None and not moved:",
        f"{TEST_OUTCOME}::test_a_target_that_is_not_known_is_no_answer",
    ),
    Mutant(
        "dgeval/hindsight/moments.py",
        "axis=1).min()) - HAND_REACH_M",
        "axis=1).min())",
        "tests/verdict/test_nearest_approach.py::test_a_hand_without_solids",
    ),
    Mutant(
        "dgeval/recording/recorded_target.py",
        'd.frame not in ("", robot.camera_frame)',
        "False",
        f"{TEST_TARGET}::test_a_detection_of_another_camera_is_none",
    ),
    Mutant(
        "dgeval/recording/recorded_target.py",
        "u, v = k.fx * x / z + k.cx, k.fy * y / z + k.cy",
        "u, v = k.fx * x / z + k.cx, k.fy * x / z + k.cy",
        f"{TEST_TARGET}::test_a_box_in_space",
    ),
    Mutant(
        "dgeval/recording/palm.py",
        "if way > CARRIED_M and ",
        "if ",
        f"{TEST_ROBOTS}::test_of_two_hands_the_one_that_grasps",
    ),
    Mutant(
        "dgeval/recording/palm.py",
        "if carrying or ways[most] < MOVES_TIMES",
        "if ways[most] < 0 * MOVES_TIMES",
        f"{TEST_ROBOTS}::test_of_two_hands_the_one_that_grasps",
    ),
    Mutant(
        "dgeval/recording/pauses.py",
        "if next_ns - t_ns > PAUSE_NS:",
        "if is_image and next_ns - t_ns > PAUSE_NS:",
        "tests/recording/test_pauses.py::test_a_recorder_that_was_paused_between_two_trials",
    ),
    Mutant(
        CLOSES,
        "last = (before_lift or closes)[-1]",
        "last = closes[-1]",
        f"{TEST_CLOSES}::test_a_gripper_that_closes_empty_after_the_last_lift_decides_nothing",
    ),
    Mutant(
        "dgeval/recording/alignment.py",
        "for corner in range(4):",
        "for corner in (0, 3):",
        "tests/recording/test_alignment.py"
        "::test_aligned_depth_is_what_the_colour_camera_would_measure",
    ),
    Mutant(
        "dgeval/recording/video.py",
        "in PLANES and not frame.is_corrupt:",
        "in PLANES:",
        "tests/recording/test_video.py::test_a_damaged_picture_is_lost_and_harms_no_other",
    ),
    Mutant(
        "dgeval/recording/scan.py",
        "pose_from_matrix(invert(matrix_from_pose(pose)))",
        "pose_from_matrix(matrix_from_pose(pose))",
        "tests/recording/test_librealsense.py::test_streams_of_a_bag_are_not_one_camera",
    ),
    Mutant(
        "dgeval/robots/recognition.py",
        "if apart > SAME_M:",
        "if apart > 3 * SAME_M:",
        "tests/robots/test_recognition.py::test_the_same_names_on_another_hand",
    ),
    # a hand by its description
    Mutant(
        "dgeval/simulation/hand_urdf.py",
        "            if joint.name in imported - followers:\n",
        "            if joint.name in imported:\n",
        "tests/simulation/test_imported_hand.py",
    ),
    Mutant(
        "dgeval/simulation/imported_hand.py",
        "= offset + factor * out",
        "= offset - factor * out",
        "tests/simulation/test_imported_hand.py",
    ),
    Mutant(
        "dgeval/simulation/hand_urdf.py",
        "element.set(key, PREFIX + element.get(key))",
        "pass",
        "tests/simulation/test_imported_hand.py",
    ),
    Mutant(
        "dgeval/simulation/record.py",
        "if not (stranger and topic.startswith(OWN_PREFIXES)):",
        "if topic:",
        "tests/simulation/test_imported_hand.py",
    ),
    Mutant(
        "dgeval/verdict/described_grip.py",
        "half_ns = (samples[0].t_ns + close_ns) // 2",
        "half_ns = close_ns",
        "tests/verdict/test_described_grip.py",
    ),
    Mutant(
        "dgeval/verdict/described_grip.py",
        "    limit = np.where(ends != hand.geometry.open, ends, limit)\n",
        "",
        "tests/verdict/test_described_grip.py",
    ),
    Mutant(
        "dgeval/robots/hand_geometry.py",
        "closed = self._followed(closed, k, given[joint.name])",
        "pass",
        "tests/robots/test_described_hand.py",
    ),
    Mutant(
        "dgeval/robots/hand_links.py",
        '        if joint.parent in group and joint.kind != "fixed"\n',
        "        if joint.parent in group\n",
        "tests/robots/test_hand_links.py",
    ),
    Mutant(
        "dgeval/robots/hand_links.py",
        'joint.kind != "fixed" and joint.follows in names for joint',
        'joint.kind != "fixed" for joint',
        "tests/robots/test_hand_links.py",
    ),
    Mutant(
        "dgeval/robots/description.py",
        "offset + multiplier * added",
        "offset + added",
        "tests/robots/test_hand_links.py",
    ),
    Mutant(
        "dgeval/robots/hand_geometry.py",
        "                if apart < best:\n",
        "                if apart > best:\n",
        "tests/robots/test_described_hand.py",
    ),
    Mutant(
        "dgeval/verdict/described_grip.py",
        "    if at_limit[closed].all():\n",
        "    if at_limit[closed].all() and False:\n",
        "tests/verdict/test_described_grip.py",
    ),
    Mutant(
        "dgeval/verdict/recorded_closing.py",
        "np.flatnonzero(moved & stopped)",
        "np.flatnonzero(moved)",
        "tests/verdict/test_described_grip.py",
    ),
    Mutant(
        OUTCOME,
        "shown is not None and shown[0] != holds[0]",
        "False and shown is not None",
        "tests/verdict/test_described_verdict.py",
    ),
    Mutant(
        "dgeval/worlds/scene.py",
        "o.disableflags |= int(",
        "o.disableflags |= 0 * int(",
        "tests/worlds/test_contacts.py",
    ),
    # a stranger's log
    Mutant(
        "dgeval/robots/convex_pieces.py",
        "mesh.volume >= CONVEX * hull.volume",
        "mesh.volume >= 0.0 * CONVEX",
        "tests/robots/test_convex_pieces.py",
    ),
    Mutant(
        "dgeval/simulation/hand_urdf.py",
        "            _take_apart(spec, body)\n",
        "            _ = body\n",
        "tests/simulation/test_imported_hand.py",
    ),
    Mutant(
        "dgeval/robots/link_shapes.py",
        "    if bound > MOST_M:\n",
        "    if bound > 1e6 * MOST_M:\n",
        "tests/robots/test_described_hand.py",
    ),
    Mutant(
        "dgeval/robots/link_shapes.py",
        "            if min(size) <= 0:\n",
        "            if min(size) < 0:\n",
        "tests/robots/test_described_hand.py",
    ),
    Mutant(
        "dgeval/robots/link_shapes.py",
        "    if beside is not None:\n",
        "    if beside is None:\n",
        "tests/robots/test_described_hand.py",
    ),
    Mutant(
        "dgeval/robots/description.py",
        "near = len(ahead) == 1 and apart < BESIDE",
        "near = len(ahead) == 1 and apart > BESIDE",
        "tests/robots/test_described_hand.py",
    ),
    Mutant(
        "dgeval/recording/scene_corrections.py",
        "(Correction(focal=focal * float(f)) for f in FINER)",
        "(Correction(focal=float(f)) for f in FINER)",
        "tests/recording/test_scene_motion.py",
    ),
    Mutant(
        "dgeval/recording/scene_motion.py",
        "axis = at[k] - moved[k] / turned[k]",
        "axis = at[k] + moved[k] / turned[k]",
        "tests/recording/test_scene_motion.py",
    ),
    Mutant(
        "dgeval/recording/scene_motion.py",
        "float(np.quantile(extents, 0.75)) >= LEAST_EXTENT",
        "float(np.quantile(extents, 0.75)) >= 0",
        "tests/recording/test_scene_motion.py",
    ),
    Mutant(
        "dgeval/recording/scene_corrections.py",
        "later_ns = round(later_s * 1e9)",
        "later_ns = round(-later_s * 1e9)",
        "tests/recording/test_scene_motion.py",
    ),
    Mutant(
        "dgeval/recording/scene_corrections.py",
        "or LEAST_TURN <= turn <= MOST_TURN",
        "or LEAST_TURN <= turn",
        "tests/recording/test_scene_motion.py",
    ),
    Mutant(
        "dgeval/recording/scene_motion.py",
        "T_base_a, T_base_b = self.T_base_a @ T_turned, self.T_base_b @ T_turned",
        "T_base_a, T_base_b = T_turned @ self.T_base_a, T_turned @ self.T_base_b",
        "tests/recording/test_scene_motion.py",
    ),
    Mutant(
        "dgeval/recording/frame_checks.py",
        "clock.colour.offset_ns={ns + clock.colour.offset_ns}",
        "clock.colour.offset_ns={-ns + clock.colour.offset_ns}",
        "tests/recording/test_scene_motion.py",
    ),
    Mutant(
        "dgeval/recording/stamp_checks.py",
        "(stamps % 1_000_000_000 < FRACTION_NS).all()",
        "(stamps % 1_000_000_000 < FRACTION_NS).sum() > len(stamps)",
        "tests/recording/test_stamps.py",
    ),
    Mutant(
        "dgeval/recording/events.py",
        "if event.t_ns - e.t_ns <= SAME_EVENT_NS]",
        "if event.t_ns - e.t_ns <= -1]",
        "tests/recording/test_stamps.py",
    ),
    Mutant(
        "dgeval/recording/recorded_target.py",
        "if boxes.max() <= IN_SHARES:",
        "if boxes.max() <= 0:",
        "tests/recording/test_recorded_target.py",
    ),
    Mutant(
        "dgeval/recording/frame_checks.py",
        "T_shifted[:3, 3] -= T[:3, :3] @ shift",
        "T_shifted[:3, 3] += T[:3, :3] @ shift",
        "tests/recording/test_hand_seen.py",
    ),
    Mutant(
        "dgeval/recording/hand_seen.py",
        "z = points[i, 0] + shift[0], points[i, 1] + shift[1], points[i, 2] + shift[2]",
        "z = points[i, 0] - shift[0], points[i, 1] - shift[1], points[i, 2] - shift[2]",
        "tests/recording/test_hand_seen.py",
    ),
    Mutant(
        "dgeval/recording/hand_seen.py",
        "through[at] += farther > same + THROUGH_M",
        "through[at] += farther < same - THROUGH_M",
        "tests/recording/test_hand_seen.py",
    ),
    Mutant(
        "dgeval/recording/hand_seen.py",
        "if s.link == link and not s.rough]",
        "if s.link == link]",
        "tests/recording/test_hand_seen.py",
    ),
    Mutant(
        "dgeval/recording/hand_seen.py",
        "shapes = outlines.get(link) or shapes",
        "shapes = list(shapes)",
        "tests/recording/test_hand_seen.py",
    ),
    Mutant(
        "dgeval/recording/hand_seen.py",
        "if best < TIMES_BETTER * there:",
        "if best < 0 * there:",
        "tests/recording/test_hand_seen.py",
    ),
    Mutant(
        "dgeval/recording/depth_edges.py",
        '"left for right": (slice(None), slice(None, None, -1), -1.0)',
        '"left for right": (slice(None), slice(None), -1.0)',
        "tests/recording/test_depth_edges.py",
    ),
    Mutant(
        "dgeval/recording/depth_edges.py",
        "down, right = -found *",
        "down, right = found *",
        "tests/recording/test_depth_edges.py",
    ),
    Mutant(
        "dgeval/recording/frame_checks.py",
        "offset_m = reader.camera.depth_offset_m + c.farther_m",
        "offset_m = reader.camera.depth_offset_m - c.farther_m",
        "tests/recording/test_scene_motion.py",
    ),
    Mutant(
        "dgeval/recording/containers/container.py",
        'head[18:20] == b"\\2\\2"',
        'head[18:20] == b"\\1\\1"',
        "tests/recording/test_stopped_recorders.py",
    ),
    Mutant(
        "dgeval/recording/closes.py",
        " or opens_after(robot, start, last_ns):",
        ":",
        "tests/recording/test_grippers.py",
    ),
    Mutant(
        "dgeval/recording/grippers.py",
        "if after < before]",
        "]",
        "tests/recording/test_grippers.py",
    ),
    Mutant(
        "dgeval/recording/description_checks.py",
        "pairs.append((matrix_from_pose(track.poses[k]), joint.moved(q)))",
        "pairs.append((joint.moved(q), joint.moved(q)))",
        "tests/recording/test_description_checks.py",
    ),
    Mutant(
        "dgeval/verdict/draws.py",
        "BLIND_DESCRIBED * described",
        "0.0 * described",
        "tests/verdict/test_decide.py",
    ),
    Mutant(
        "dgeval/simulation/hand_urdf.py",
        "joint.damping = [DAMPING[slides], 0, 0]",
        "joint.damping = [DAMPING[slides]] * 3",
        "tests/simulation/test_imported_hand.py",
    ),
    Mutant(
        "dgeval/recording/scene_motion.py",
        "np.minimum(still, np.linalg.norm(shift - moving, axis=1)) / moved",
        "still / moved",
        "tests/recording/test_scene_motion.py",
    ),
    Mutant(
        "dgeval/recording/scene_motion.py",
        "a, b = a[~with_camera], b[~with_camera]",
        "a, b = a.copy(), b.copy()",
        "tests/recording/test_scene_motion.py",
    ),
    Mutant(
        "dgeval/geometry.py",
        "proper[..., 2] = np.sign(np.linalg.det(V @ Ut))",
        "proper[..., 2] = 1.0",
        "tests/recording/test_scene_motion.py",
    ),
    Mutant(
        "dgeval/recording/frame_checks.py",
        "    if share <= CONTRADICTS:\n",
        "    if share <= 10 * CONTRADICTS:\n",
        "tests/recording/test_scene_motion.py",
    ),
    Mutant(
        "dgeval/recording/camera_poses.py",
        "    if share > CONTRADICTS:\n",
        "    if share > 10 * CONTRADICTS:\n",
        "tests/recording/test_camera_poses.py",
    ),
    Mutant(
        "dgeval/recording/camera_poses.py",
        "if apart <= MOST_FROM_PALM_M:",
        "if apart <= 100 * MOST_FROM_PALM_M:",
        "tests/recording/test_camera_poses.py",
    ),
    Mutant(
        "dgeval/recording/frozen.py",
        "        if lasts_s <= HANGS_S:\n",
        "        if lasts_s <= 100 * HANGS_S:\n",
        "tests/recording/test_second_strangers.py",
    ),
    Mutant(
        "dgeval/recording/robot.py",
        "    if moves(chain[-1]):\n",
        "    if True:\n",
        "tests/recording/test_second_strangers.py",
    ),
    Mutant(
        "dgeval/recording/events.py",
        "return event.kind == LABEL_EVENT or any(key in event.fields for key in LABEL_KEYS)",
        "return event.kind == LABEL_EVENT",
        "tests/recording/test_second_strangers.py",
    ),
    Mutant(
        "dgeval/recording/transforms.py",
        "np.roll(pose[3:], -1)",
        "np.roll(pose[3:], 1)",
        "tests/recording/test_second_strangers.py",
    ),
    Mutant(
        "dgeval/hindsight/smoothing.py",
        "back @ (P[k + 1] - ahead[k + 1]) @ back.T",
        "back @ P[k + 1] @ back.T",
        "tests/hindsight/test_smoothing.py::test_smoother_is_filterpys",
    ),
    Mutant(
        "dgeval/planning/vfas/replayed.py",
        "T_base_goal=selected.T_base_goal @ self._T_grasp_palm",
        "T_base_goal=selected.T_base_goal @ self._T_palm_grasp",
        "tests/planning/test_gripper.py::test_poses_go_in_and_come_out_as_the_palms",
    ),
    Mutant(
        "dgeval/planning/vfas/gripper.py",
        "np.where(u + v > 1, 1 - u, u)",
        "np.where(u + v > 1, u, u)",
        "tests/planning/test_gripper.py::test_frame_width_and_links_are_the_descriptions",
    ),
    Mutant(
        "dgeval/verdict/recorded_lift.py",
        "if len(ahead) > wait and ahead.max() - rises[k] < LIFTED_M:",
        "if ahead.max() - rises[k] < LIFTED_M:",
        "tests/verdict/test_recorded_lift.py::test_what_is_no_whole_lift_is_none",
    ),
    Mutant(
        "dgeval/worlds/closing.py",
        "return min(MIN_LIFT, 0.5 * float(self.rises[-1]))",
        "return MIN_LIFT",
        "tests/worlds/test_close_and_lift.py::test_a_lift_as_recorded_is_followed_and_sets_the_height",
    ),
    Mutant(
        "dgeval/robots/mjcf_description.py",
        "names[other], a1, at + a0 - a1 * at_other",
        "names[other], a1, a0",
        "tests/robots/test_mjcf_description.py::test_solids_limits_and_coupling",
    ),
    Mutant(
        "dgeval/robots/mjcf_description.py",
        "above, origin = joint.child, invert(anchor)",
        "above, origin = joint.child, np.eye(4)",
        "tests/robots/test_mjcf_description.py::test_links_are_where_mujoco_has_them",
    ),
    Mutant(
        "dgeval/robots/mjcf_description.py",
        "replace(joint, origin=joint.moved(start))",
        "joint",
        "tests/robots/test_mjcf_description.py::test_links_are_where_mujoco_has_them",
    ),
    Mutant(
        "dgeval/hindsight/free_path.py",
        "while len(used) > LEAST_COUNT and hand_from(used[-1]) < TOUCHING_M:",
        "while False:",
        "tests/hindsight/test_free_path.py::test_a_push_does_not_bend_the_path_before_it",
    ),
    Mutant(
        "dgeval/hindsight/free_path.py",
        "and hand_from(s) >= TOUCHING_M:",
        "and True:",
        "tests/hindsight/test_free_path.py::test_a_push_does_not_bend_the_path_before_it",
    ),
    Mutant(
        DRAWS,
        "force, softened = 0.5 * force, softened + 1",
        "force, softened = 0.9 * force, softened + 1",
        f"{TEST_DECIDE}::test_a_grip_that_presses_too_deep_is_made_again_with_less_force",
    ),
    Mutant(
        "dgeval/verdict/evidence.py",
        "elif log.elsewhere.closing is not None:",
        "elif False:",
        TEST_ESTIMATES,
    ),
    Mutant("dgeval/runs/estimates.py", "LEAST_ALIKE = 2  #", "LEAST_ALIKE = 1  #", TEST_ESTIMATES),
    Mutant(
        "dgeval/runs/estimates.py",
        'key=lambda f: (int(np.count_nonzero(f[1]["speeds"])),',
        'key=lambda f: (-int(np.count_nonzero(f[1]["speeds"])),',
        TEST_ESTIMATES,
    ),
    Mutant(
        "dgeval/verdict/described_grip.py",
        "(np.sign(reached - start) * (empty - rest) > AT_LIMIT * span)",
        "(np.sign(reached - start) * (rest - empty) > AT_LIMIT * span)",
        TEST_ESTIMATES,
    ),
    Mutant(
        "dgeval/verdict/recorded_force.py",
        "abs(after - before) / lever",
        "abs(after) / lever",
        TEST_ESTIMATES,
    ),
    Mutant(
        "dgeval/verdict/recorded_closing.py",
        "standing = np.flatnonzero((over <= STANDS * fastest)",
        "standing = np.flatnonzero((over <= 0.0 * fastest)",
        "tests/verdict/test_described_grip.py",
    ),
    Mutant(
        "dgeval/recording/closing_motion.py",
        "return int(np.clip(count / 2, 1, MOST_HALF))",
        "return 1",
        "tests/recording/test_closes.py",
    ),
    Mutant(
        "dgeval/recording/joint_names.py",
        "if len(longs) == len(found[best]) else None",
        "if longs else None",
        "tests/recording/test_joint_names.py",
    ),
    Mutant(
        "dgeval/verdict/outcome.py",
        "if hindsight.n_registered < MIN_REGISTERED:",
        "if False:",
        "tests/verdict/test_outcome.py",
    ),
    Mutant(
        "dgeval/verdict/outcome.py",
        "return ends_ns if log.released_ns is None else min(ends_ns, log.released_ns)",
        "return ends_ns",
        "tests/verdict/test_outcome.py",
    ),
    Mutant(
        "dgeval/recording/clocks.py",
        "return [i for i in out if alone[int(stamps[i])]]",
        "return out",
        "tests/recording/test_clocks.py",
    ),
    Mutant(
        "dgeval/recording/clocks.py",
        "if not least or max(least) - min(least) > same_s:",
        "if not least:",
        "tests/recording/test_clocks.py",
    ),
    Mutant(
        "dgeval/recording/closes.py",
        "if isinstance(found, NoClose) or not found.rest_ns + LATE_NS < close_ns",
        "if isinstance(found, NoClose) or not found.lift_ns + UP_NS < close_ns",
        "tests/recording/test_third_strangers.py",
    ),
    Mutant(
        "dgeval/verdict/recorded_closing.py",
        "ticks = (since_close + lags) / CONTROL_S",
        "ticks = (since_close + 0.0 * lags) / CONTROL_S",
        "tests/verdict/test_described_grip.py",
    ),
    Mutant(
        "dgeval/verdict/recorded_closing.py",
        "stopped &= stands < stands[free].max() - TOGETHER_TICKS",
        "stopped &= stands >= 0",
        "tests/verdict/test_described_grip.py",
    ),
    Mutant(
        "dgeval/perception/registration.py",
        "(along < limit) & (beside < most)",
        "(distance < limit) & (beside < most)",
        "tests/perception/test_stages.py",
    ),
    Mutant(
        "dgeval/perception/registration.py",
        "APART * spacing(model, tree))",
        "100 * APART * spacing(model, tree))",
        "tests/perception/test_stages.py",
    ),
    Mutant(
        "dgeval/perception/depth_noise.py",
        "LEVEL_M / 0.6745 / np.sqrt(2)",
        "LEVEL_M / 0.6745",
        "tests/perception/test_depth_noise.py",
    ),
    Mutant(
        "dgeval/perception/depth_noise.py",
        "BELIEVED = 1.0, 3.0",
        "BELIEVED = 0.1, 30.0",
        "tests/perception/test_depth_noise.py",
    ),
    Mutant(
        MODEL_TRACKER,
        "depth, window, free & ~unlike, points,",
        "depth, window, free, points,",
        TEST_LOOKS,
    ),
    Mutant(
        MODEL_TRACKER,
        'if tracked.state == "lost" or alike < LEAST_ALIKE:',
        'if tracked.state == "lost":',
        TEST_LOOKS,
    ),
    Mutant(
        MODEL_TRACKER,
        "reacquired=was_lost,",
        "reacquired=False,",
        TEST_LOOKS,
    ),
    Mutant(
        "dgeval/perception/redetection.py",
        "T[:3, 3] += np.median(points, axis=0)",
        "T[:3, 3] += 0 * np.median(points, axis=0)",
        TEST_LOOKS,
    ),
    Mutant(
        "dgeval/perception/redetection.py",
        "measured = len(z) >= max(LEAST_PX, LEAST_MEASURED * pixels)",
        "measured = len(z) >= LEAST_PX",
        TEST_LOOKS,
    ),
    Mutant(
        "dgeval/perception/segmentation.py",
        "(depth < front - IN_FRONT_M)",
        "(depth > front + IN_FRONT_M)",
        TEST_LOOKS,
    ),
    Mutant(
        "dgeval/perception/appearance.py",
        "FIRST = 0.5 ",
        "FIRST = 0.0 ",
        TEST_LOOKS,
    ),
    Mutant(
        "dgeval/perception/appearance.py",
        "PATCH = 0.2 ",
        "PATCH = 0.0 ",
        TEST_LOOKS,
    ),
    Mutant(
        "dgeval/perception/fusion.py",
        "min(LEAST_IN_CUBE, fit)",
        "min(0, fit)",
        "tests/perception/test_model_keeps.py",
    ),
    Mutant(
        "dgeval/perception/free_space.py",
        "z > expected + margin",
        "z > expected",
        "tests/perception/test_model_keeps.py",
    ),
    Mutant(
        "dgeval/perception/fusion.py",
        "if stays.sum() >= LEAST_KEPT * len(stays):",
        "if True:",
        "tests/perception/test_model_keeps.py",
    ),
    Mutant(
        "dgeval/perception/registration.py",
        "close |= np.all(each, axis=0)",
        "close |= np.any(each, axis=0)",
        "tests/perception/test_refusals.py",
    ),
    Mutant(
        "dgeval/perception/pipeline.py",
        "[*state.refused, seen][-REFUSED_FRAMES:]",
        "[]",
        "tests/perception/test_refusals.py",
    ),
    Mutant(
        "dgeval/perception/pipeline.py",
        "if apart < UNSTEADY * most else np.zeros(3)",
        "",
        "tests/perception/test_tracking.py",
    ),
    Mutant(
        "dgeval/perception/pipeline.py",
        "> LEAST_TURN:",
        "> 1e9:",
        "tests/perception/test_tracking.py",
    ),
    Mutant(
        "dgeval/perception/pipeline.py",
        "if tracked.pose_stands else carried",
        "if False else carried",
        "tests/perception/test_recorded_tracker.py",
    ),
    Mutant(
        "dgeval/perception/pipeline.py",
        "    if tracked.pose_stands:\n",
        "    if False:\n",
        "tests/perception/test_recorded_tracker.py",
    ),
    Mutant(
        "dgeval/perception/trackers/recorded.py",
        "if self._name and thing.name == self._name]",
        "if False]",
        "tests/perception/test_recorded_tracker.py",
    ),
    Mutant(
        "dgeval/perception/trackers/recorded.py",
        "round(thing.box[0]) - window[0]",
        "round(thing.box[0]) - window[0] + 2",
        "tests/perception/test_recorded_tracker.py",
    ),
    Mutant(
        "dgeval/recording/recorded_target.py",
        'f"{topic}#{d.name}" if d.name else ""',
        '""',
        "tests/recording/test_recorded_tracking.py",
    ),
    Mutant(
        "dgeval/recording/recorded_target.py",
        "if at.shape != size[::-1]:",
        "if False:",
        "tests/recording/test_recorded_tracking.py",
    ),
    Mutant(
        "dgeval/perception/align.py",
        "behind = behind[behind < HIDDEN_M]",
        "behind = behind[:]",
        "tests/perception/test_stages.py",
    ),
    Mutant(
        "dgeval/perception/trackers/recorded.py",
        "is_elsewhere = not self._was_lost and",
        "is_elsewhere = False and",
        "tests/perception/test_recorded_tracker.py",
    ),
    Mutant(
        "dgeval/recording/recorded_target.py",
        "if is_lossy or soft else mask",
        "if is_lossy else mask",
        "tests/recording/test_recorded_tracking.py",
    ),
    Mutant(
        "dgeval/recording/recorded_target.py",
        "return min(SAME_IMAGE_NS, int(",
        "return max(SAME_IMAGE_NS, int(",
        "tests/recording/test_recorded_tracking.py",
    ),
    Mutant(
        "dgeval/recording/recorded_target.py",
        "if seen.setdefault(at, mark.t_ns) != mark.t_ns:",
        "if seen.setdefault(at, 0) != mark.t_ns:",
        "tests/recording/test_recorded_tracking.py",
    ),
    Mutant(
        "dgeval/perception/registration.py",
        "< AS_MANY * seen:",
        "< 0 * seen:",
        "tests/perception/test_stages.py",
    ),
    Mutant(
        "dgeval/planning/carried.py",
        "self.velocity * ((t_ns - self.t_ns) * 1e-9)",
        "0 * self.velocity",
        "tests/planning/test_control.py",
    ),
    Mutant(
        "dgeval/planning/proposals.py",
        "if seen or self._chosen is None:",
        "if True:",
        "tests/planning/test_control.py",
    ),
    Mutant(
        "dgeval/planning/control.py",
        "return self._at(states, is_period=True)",
        "return self._at(states[:1], is_period=True)",
        "tests/planning/test_control.py",
    ),
    Mutant(
        "dgeval/planning/model_grasps.py",
        "T_object_hand = invert(T_base_object) @ palm",
        "T_object_hand = palm",
        "tests/planning/test_control.py",
    ),
    Mutant(
        "dgeval/planning/recorded_grasps.py",
        "score = self._recorded.scores.at(t_ns)",
        "score = self._recorded.hand_scores.at(t_ns)",
        "tests/planning/test_control.py",
    ),
    Mutant(
        "dgeval/perception/pipeline.py",
        "carried = self.predict(frame, T_base_camera, self.T_carried, moves)",
        "carried = self.predict(frame, T_base_camera, self.T_carried)",
        "tests/replay/test_replay.py::test_a_lost_target_goes_on_or_stands_still",
    ),
    Mutant(
        "dgeval/planning/servo.py",
        "if is_period and (self._last is None",
        "if (self._last is None",
        "tests/perception/test_stages.py",
    ),
    Mutant(
        "dgeval/planning/vfas/replayed.py",
        "self._due_ns += period_ns * max",
        "self._due_ns = t_ns + period_ns * max",
        "tests/planning/test_gripper.py",
    ),
    Mutant(
        "dgeval/planning/vfas/selection.py",
        "else self.tracking\n",
        "else True\n",
        "tests/planning/test_vfas.py",
    ),
    Mutant(
        "dgeval/planning/reachability.py",
        "(np.asarray(q, dtype=np.float64), *self._starts)",
        "(np.asarray(q, dtype=np.float64),)",
        "tests/networks/test_networks.py::test_arm_of_the_description_is_the_arm",
    ),
    Mutant(
        "dgeval/perception/trackers/model.py",
        "or float((depth == 0).mean()) < NO_DEPTH",
        "",
        "tests/perception/test_tracking.py",
    ),
    Mutant(
        "dgeval/config.py",
        "for key, value in values.items() if key not in given}",
        "for key, value in values.items()}",
        "tests/test_config.py",
    ),
    Mutant(
        "dgeval/replay/causal.py",
        "bisect_left(stamps, last_ns), bisect_left(stamps, frame.t_ns)",
        "0, 0",
        "tests/replay/test_replay.py::test_control_runs_at_the_rate_of_the_states",
    ),
    Mutant(
        "dgeval/replay/fidelity.py",
        "theirs @ invert(self._first[1]) @ self._first[0]",
        "theirs",
        "tests/replay/test_fidelity.py",
    ),
    Mutant(
        "dgeval/replay/fidelity.py",
        "    if len(last) < LEAST_VALUES:",
        "    if not last:",
        "tests/replay/test_fidelity.py",
    ),
    Mutant(
        "dgeval/replay/fidelity.py",
        "if not self._chooses or control.grasps is None",
        "if control.grasps is None",
        "tests/replay/test_fidelity.py",
    ),
    Mutant(
        "dgeval/recording/choices.py",
        "out.setdefault(times[k - 1], bool(value))",
        "out[times[k - 1]] = bool(value)",
        "tests/recording/test_trial_parts.py",
    ),
    Mutant(
        "dgeval/perception/pipeline.py",
        'reject_reason=None if frame.accepted else "recorded"',
        "reject_reason=result.reject_reason",
        "tests/perception/test_tracking.py",
    ),
    Mutant(
        "dgeval/verdict/judge.py",
        "None if not near else max(near) >= 0.5",
        "None if not near else max(near) > 0.0",
        "tests/verdict/test_close_times.py",
    ),
    Mutant(
        "dgeval/recording/choices.py",
        "max([start_ns - round(BEFORE_S * 1e9), *before])",
        "start_ns - round(BEFORE_S * 1e9)",
        "tests/recording/test_trial_parts.py",
    ),
    Mutant(
        "dgeval/recording/choices.py",
        "max(pose.t_ns, log_ns) if one_clock",
        "pose.t_ns if one_clock",
        "tests/recording/test_trial_parts.py",
    ),
    Mutant(
        "dgeval/planning/servo.py",
        "apart_ns > GAP_NS",
        "apart_ns > 100 * GAP_NS",
        "tests/perception/test_stages.py",
    ),
    Mutant(
        "dgeval/recording/robot.py",
        "EARLY * least_s * 1e9",
        "least_s * 1e9",
        "tests/planning/test_control.py",
    ),
    Mutant(
        "dgeval/replay/fidelity.py",
        "2 * len(last) < theirs",
        "len(last) > theirs",
        "tests/replay/test_fidelity.py",
    ),
    Mutant(
        "dgeval/failure_rule.py",
        "    if seen.touched and moved:",
        "    if moved:",
        "tests/test_failure_rule.py::test_a_push_before_the_close_is_seen_as_a_collision_whatever_it_mattered",
    ),
    Mutant(
        "dgeval/failure_rule.py",
        "        if share < th.inside_share:",
        "        if share < 0.0:",
        "tests/test_failure_rule.py::test_where_the_object_was_when_the_hand_closed",
    ),
    Mutant(
        "dgeval/failure_rule.py",
        "        began = offset if began is None else began",
        "        began = offset if began is None else seen.reach[0][0]",
        "tests/test_failure_rule.py::test_where_the_object_was_when_the_hand_closed",
    ),
    Mutant(
        "dgeval/failure_rule.py",
        "    share_then = min(seen.reach, key=lambda r: abs(r[0] - met_s))[1]",
        "    share_then = min(seen.reach, key=lambda r: abs(r[0]))[1]",
        "tests/test_failure_rule.py::test_where_the_object_was_when_the_hand_closed",
    ),
    Mutant(
        "dgeval/worlds/closing_region.py",
        "        data.qpos[at] = np.clip(reached, lower, upper)",
        "        data.qpos[at] = reached",
        "tests/worlds/test_closing_region.py::test_what_a_hand_is_told_beyond_its_limits_is_not_swept",
    ),
    Mutant(
        "dgeval/worlds/closing_region.py",
        "        T_hand_base = invert(pose_of(data, BASE))",
        "        T_hand_base = np.eye(4)",
        "tests/worlds/test_closing_region.py::test_the_region_is_in_the_frame_of_the_hand_on_an_arm",
    ),
    Mutant(
        "dgeval/worlds/closing_region.py",
        "    return [g for g in solid if int(model.geom_bodyid[g]) in with_solids - before]",
        "    return solid",
        "tests/worlds/test_closing_region.py::test_the_fingers_of_a_hand_sweep_in_front_of_its_palm",
    ),
    Mutant(
        "dgeval/worlds/closing_region.py",
        "        points = np.concatenate([corners, lattice[inside]])",
        "        points = corners",
        "tests/worlds/test_closing_region.py::test_an_object_between_the_jaws_and_one_before_them",
    ),
    Mutant(
        "dgeval/verdict/draws.py",
        "        (observed(twin.seen, thresholds), float(w) / best)",
        "        (observed(twin.seen), float(w) / best)",
        "tests/verdict/test_decide.py::test_a_held_object_that_gives_way_is_not_seen_pushed",
    ),
    Mutant(
        "dgeval/verdict/decide.py",
        "    unclear = draws.share_reproduced < TRUSTED or float(seen.max()) < min_probability",
        "    unclear = float(seen.max()) < min_probability",
        "tests/verdict/test_decide.py::test_draws_that_see_different_things_leave_it_unknown",
    ),
    Mutant(
        "dgeval/report/summary.py",
        '    counts_alike = column == "observed_class" and len(scenarios) == 1',
        "    counts_alike = len(scenarios) == 1",
        "tests/verdict/test_verdict.py::test_shares_leave_out_what_did_not_end",
    ),
    Mutant(
        "dgeval/recording/choices.py",
        "            return T_base_parent @ T\n    return None",
        "            return T_base_parent @ T\n    return T",
        "tests/recording/test_choices.py::test_a_pose_in_a_frame_that_nothing_places_is_not_taken_as_of_the_base",
    ),
    Mutant(
        "dgeval/recording/scan.py",
        "        and not name.startswith(OWN_PREFIXES)",
        "        and name",
        "tests/recording/test_choices.py::test_beliefs_that_are_stamped_by_the_recorder_follow_its_clock",
    ),
    Mutant(
        "dgeval/planning/recorded_arm.py",
        "return self.arm.solve(self.T_arm_base @ T_base_palm, self.q)",
        "return self.arm.solve(T_base_palm, self.q)",
        "tests/networks/test_networks.py::test_an_arm_that_stands_in_a_world_is_asked_in_its_own_frame",
    ),
    Mutant(
        "dgeval/replay/causal.py",
        "        is_own = config.execution.c_e is None and not config.schedule.grasps_latency_s",
        "        is_own = config.execution.c_e is None",
        "tests/planning/test_control.py::test_decisions_speak_of_the_grasps_as_the_robot_had_them",
    ),
    Mutant(
        "dgeval/evaluate/tables.py",
        '    return table.get("without" if arm == "without" else section, {}), n',
        "    return table.get(section, {}), n",
        "tests/evaluate/test_tables.py::test_the_other_papers_arms_are_beside_their_own_columns",
    ),
    Mutant(
        "dgeval/evaluate/tables.py",
        '                is_beside = column == "observed_class" and given',
        "                is_beside = given",
        "tests/evaluate/test_tables.py::test_the_dynamic_papers_tables",
    ),
    Mutant(
        "dgeval/evaluate/tables.py",
        "        both = sorted(set(old) & set(new))",
        "        both = sorted(old)[: len(new)]",
        "tests/evaluate/test_tables.py::test_arms_are_paired_by_trial",
    ),
    Mutant(
        "dgeval/hindsight/surface.py",
        "            sums = sums[kept]",
        "            pass",
        "tests/verdict/test_verdict.py::test_surface_forgets_what_one_frame_took_for_the_object",
    ),
    Mutant(
        "dgeval/networks/gmflow.py",
        "self.k_proj(query)[None]",
        "self.k_proj(cells)[None]",
        "tests/networks/test_gmflow.py",
    ),
    Mutant(
        "dgeval/networks/gmflow.py",
        "mask if k % 2 else None",
        "None",
        "tests/networks/test_gmflow.py",
    ),
    Mutant(
        "dgeval/planning/vfas/motion_field.py",
        "last[0] is before",
        "True",
        "tests/networks/test_gmflow.py",
    ),
    Mutant(
        "dgeval/networks/transt.py",
        "self.layer3 = _layer(512, 256, 6, 1, 2)",
        "self.layer3 = _layer(512, 256, 6, 1, 1)",
        "tests/networks/test_transt.py",
    ),
    Mutant(
        "dgeval/networks/transt.py",
        "MASK_TOKEN = 119",
        "MASK_TOKEN = 120",
        "tests/networks/test_transt.py",
    ),
    Mutant(
        "dgeval/networks/transt.py",
        "logits.flatten().softmax(0)",
        "logits.softmax(1)",
        "tests/networks/test_transt.py",
    ),
    Mutant(
        "dgeval/perception/trackers/transt.py",
        "found.score < c.lost_below or",
        "",
        "tests/perception/test_transt_tracker.py",
    ),
    Mutant(
        "dgeval/perception/trackers/transt.py",
        "mask = free & (found",
        "mask = (found",
        "tests/perception/test_transt_tracker.py",
    ),
    Mutant(
        "dgeval/networks/transt_loop.py",
        "- (side + 1) / 2 + 0.5",
        "- (side + 1) / 2",
        "tests/networks/test_transt.py",
    ),
    Mutant(
        "dgeval/networks/transt_loop.py",
        "(self._templates[0], self._template(image))",
        "(self._templates[0], self._templates[0])",
        "tests/networks/test_transt.py",
    ),
    Mutant(
        "dgeval/planning/vfas/contacts.py",
        "usable &= KDTree(target)",
        "KDTree(target)",
        "tests/planning/test_contact_seeds.py",
    ),
    Mutant(
        "dgeval/planning/vfas/contacts.py",
        "& (grasps.width <= opening)",
        "",
        "tests/planning/test_contact_seeds.py",
    ),
    Mutant(
        "dgeval/planning/vfas/contacts.py",
        "rooms = [reach(T), reach(T @ back)]",
        "rooms = [reach(T), reach(T)]",
        "tests/planning/test_contact_seeds.py",
    ),
    Mutant(
        "dgeval/planning/reachability.py",
        "return float(2 * nearest.min())",
        "return float(2 * nearest.max())",
        "tests/networks/test_networks.py",
    ),
    Mutant(
        "dgeval/hindsight/chosen_grasp.py",
        "hindsight.path.at(t_ns)",
        "hindsight.path.at(0)",
        "tests/hindsight/test_chosen_grasp.py",
    ),
    Mutant(
        "dgeval/runs/trial_job.py",
        'config.model_dump(mode="json"), files, about',
        'config.model_dump(mode="json"), about',
        "tests/replay/test_replay.py::test_other_content_of_a_named_file_is_another_result",
    ),
    Mutant(
        "dgeval/simulation/setting.py",
        "(t - self.start) / RAMP_S",
        "t / RAMP_S",
        "tests/simulation/test_late_belt.py",
    ),
    Mutant(
        "dgeval/simulation/world.py",
        "0.0 if self.setting.belt is not None else object_velocity",
        "object_velocity",
        "tests/simulation/test_late_belt.py",
    ),
    Mutant(
        "dgeval/simulation/perception.py",
        "if len(measured) < self._least:",
        "if False:",
        "tests/simulation/test_modelled_cloud.py",
    ),
    Mutant(
        "dgeval/simulation/perception.py",
        "in_image & (cosine > LEAST_COSINE)",
        "in_image",
        "tests/simulation/test_modelled_cloud.py",
    ),
    Mutant(
        "dgeval/replay/fidelity.py",
        'words.get("twist") is True and False not in words.values()',
        'words.get("twist") is True',
        "tests/replay/test_fidelity.py",
    ),
    Mutant(
        "dgeval/verdict/log.py",
        'own["model"] = lambda _: replay.model',
        'own["model"] = self.model',
        "tests/replay/test_fidelity.py",
    ),
    Mutant(
        "dgeval/replay/fidelity.py",
        "        at = t - late_s\n",
        "        at = t + late_s\n",
        "tests/replay/test_fidelity.py",
    ),
    Mutant(
        "dgeval/replay/fidelity.py",
        "return all(e <= SAME * b.most for",
        "return all(e <= b.most for",
        "tests/replay/test_fidelity.py",
    ),
    Mutant(
        "dgeval/replay/fidelity.py",
        "is_faithful = None if one.is_faithful is False and excused",
        "is_faithful = None if excused",
        "tests/replay/test_fidelity.py",
    ),
    Mutant(
        "dgeval/replay/fidelity.py",
        '"seed": config.seed + k + 1',
        '"seed": config.seed + k',
        "tests/replay/test_fidelity.py",
    ),
    Mutant(
        "dgeval/planning/recorded_candidates.py",
        "is_kept = kept is not None and _is_same(poses[-1], kept[0])",
        "is_kept = kept is not None",
        "tests/planning/test_recorded_candidates.py",
    ),
    Mutant(
        "dgeval/planning/recorded_candidates.py",
        "poses = invert(belief.T_base_object) @ one.T_base_palm",
        "poses = one.T_base_palm",
        "tests/planning/test_recorded_candidates.py",
    ),
    Mutant(
        "dgeval/planning/proposals.py",
        "proposals.left_out.update(self._feasible.refused())",
        "pass",
        "tests/planning/test_recorded_candidates.py",
    ),
    Mutant(
        "dgeval/simulation/record.py",
        "poses = T_base_object @ proposals.T_object_palm[rows]",
        "poses = proposals.T_object_palm[rows]",
        "tests/planning/test_recorded_candidates.py",
    ),
    Mutant(
        "dgeval/recording/choices.py",
        "scores.setdefault(bisect_right(logged, log_ns + SCORE_LATE_NS) - 1, values)",
        "scores.setdefault(bisect_right(logged, log_ns + SCORE_LATE_NS), values)",
        "tests/recording/test_choices.py",
    ),
    Mutant(
        "dgeval/replay/own_inputs.py",
        "if seen and T_camera_model is not None:",
        "if T_camera_model is not None and not seen:",
        "tests/replay/test_fidelity.py",
    ),
    Mutant(
        "dgeval/recording/encodings/foxglove.py",
        'ljust(9, "0")',
        'rjust(9, "0")',
        "tests/recording/test_foxglove_json.py::test_times_as_texts",
    ),
    Mutant(
        "dgeval/recording/clocks.py",
        "elif t > highest:",
        "elif t < highest:",
        "tests/recording/test_packagings.py::test_one_stamp_ahead_costs_one_image",
    ),
    Mutant(
        "dgeval/recording/roles.py",
        '            _has(n, *WANTED),\n            not _has(n, "joint_states"),',
        '            not _has(n, "joint_states"),',
        "tests/recording/test_other_pictures.py::test_joint_positions_that_were_wanted_are_not_measured",
    ),
    Mutant(
        "dgeval/recording/cameras.py",
        "depth.frame_id not in placed.keys() | {parent for parent, _ in placed.values()}",
        "depth.frame_id in placed.keys()",
        "tests/recording/test_other_pictures.py::test_aligned_depth_under_a_frame_that_nothing_places",
    ),
    Mutant(
        "dgeval/recording/scene_corrections.py",
        "inverse = inverse + (ray - at) @ slope",
        "inverse = inverse",
        "tests/recording/test_scene_motion.py::test_depth_alone_that_is_late_is_told_with_the_delay",
    ),
    Mutant(
        "dgeval/recording/checks.py",
        "rarer = min(count, key",
        "rarer = max(count, key",
        "tests/recording/test_trial_parts.py::test_pictures_without_a_partner_are_lost_by_the_rarer_stream",
    ),
    Mutant(
        "dgeval/recording/copies.py",
        "first.setdefault(sha256_of(file), file)",
        'first.setdefault("", file)',
        "tests/recording/test_copies.py::test_what_rosbag_reindex_leaves",
    ),
    Mutant(
        "dgeval/runs/target_told.py",
        "if name in SPOILS_DEPTH",
        "if name not in SPOILS_DEPTH",
        "tests/replay/test_notes.py::test_another_box_is_no_mend_for_wrong_depth",
    ),
    Mutant(
        "dgeval/recording/containers/rosbags.py",
        "reader.end_time - 1",
        "reader.end_time",
        "tests/recording/test_packagings.py::test_the_span_of_a_file_by_its_index_is_that_of_its_messages",
    ),
    Mutant(
        "dgeval/recording/grippers.py",
        "known |= kind == BOOL and is_command_topic(name, kind)",
        "known |= kind == BOOL",
        "tests/recording/test_grippers.py",
    ),
    Mutant(
        "dgeval/recording/two_sources.py",
        "if links & set(recorded.ancestors(parent)):",
        "if not links & set(recorded.ancestors(parent)):",
        "tests/recording/test_seventh_strangers.py::test_a_camera_in_a_map_of_its_own_leaves_the_robot_its_camera",
    ),
    Mutant(
        "dgeval/recording/two_sources.py",
        "if far <= APART_M and",
        "if far <= 1.0 and",
        "tests/recording/test_seventh_strangers.py::test_a_calibrated_mount_beside_a_nominal_one_is_told",
    ),
    Mutant(
        "dgeval/recording/containers/container.py",
        'topic.removeprefix("rt/")',
        "topic",
        "tests/recording/test_seventh_strangers.py::test_topics_by_other_middlewares_names",
    ),
    Mutant(
        "dgeval/recording/containers/container.py",
        "own.count(short) == 1",
        "own.count(short) == 2",
        "tests/recording/test_seventh_strangers.py::test_topics_by_other_middlewares_names",
    ),
    Mutant(
        "dgeval/recording/roles.py",
        "if topics[n].type == JOINT_STATE]",
        "if topics[n].type != JOINT_STATE]",
        "tests/recording/test_seventh_strangers.py::test_ros2_controls_own_states",
    ),
    Mutant(
        "dgeval/recording/roles.py",
        'presses = joint_owners(scan, topics, "efforts")',
        "presses = joint_owners(scan, topics)",
        "tests/recording/test_seventh_strangers.py::test_efforts_on_a_topic_of_their_own_are_the_joints",
    ),
    Mutant(
        "dgeval/recording/images.py",
        "if farthest < LEAST_FILLER_M:",
        "if farthest > LEAST_FILLER_M:",
        "tests/recording/test_images.py::test_a_far_value_in_many_pixels_is_no_reading",
    ),
    Mutant(
        "dgeval/recording/image_codecs/raw.py",
        "int(message.step) or row",
        "int(message.step)",
        "tests/recording/test_seventh_strangers.py::test_a_picture_without_a_step",
    ),
    Mutant(
        "dgeval/recording/events.py",
        "event.t_ns - out[-1].t_ns < PRESSED_AGAIN_NS",
        "event.t_ns - out[-1].t_ns > PRESSED_AGAIN_NS",
        "tests/recording/test_seventh_strangers.py::test_two_trials_stay_two",
    ),
    Mutant(
        "dgeval/recording/scan.py",
        "most = max(by_model",
        "most = min(by_model",
        "tests/recording/test_seventh_strangers.py::test_intrinsics_of_a_former_mode_do_not_count",
    ),
    Mutant(
        "dgeval/recording/frame_checks.py",
        "shifted is not None and shifted > CONTRADICTS",
        "shifted is not None and shifted < CONTRADICTS",
        "tests/recording/test_seventh_strangers.py::test_images_that_are_logged_late_are_no_clock_that_is_off",
    ),
    Mutant(
        "dgeval/recording/stamp_checks.py",
        ">= BURST * float",
        "< BURST * float",
        "tests/recording/test_seventh_strangers.py::test_states_stamped_when_their_packet_arrives_fail_their_check",
    ),
    Mutant(
        "dgeval/recording/depth_unit.py",
        "smoother = rough[1] < SMOOTHER",
        "smoother = rough[1] > SMOOTHER",
        "tests/recording/test_seventh_strangers.py::test_depth_whose_bytes_are_swapped_is_told_so",
    ),
    Mutant(
        "dgeval/recording/checks.py",
        "if not drift or not explained:",
        "if drift or not explained:",
        "tests/recording/test_seventh_strangers.py::test_a_camera_whose_clock_runs_faster_is_no_wrong_depth",
    ),
    Mutant(
        "dgeval/recording/checks.py",
        "* (early > LONGEST_GAP_S)",
        "* (early > 9 * LONGEST_GAP_S)",
        "tests/recording/test_seventh_strangers.py::test_joint_states_of_a_part_of_the_trial_fail_a_check",
    ),
    Mutant(
        "dgeval/cli/boundary.py",
        "    if not text:\n        raise typer",
        "    if text is None:\n        raise typer",
        "tests/recording/test_seventh_strangers.py::test_an_empty_path_is_not_the_working_folder",
    ),
    Mutant(
        "dgeval/perception/pipeline.py",
        "state.T_carried = own if by_depth else carried",
        "state.T_carried = carried if own is None else own",
        "tests/perception/test_tracking.py::test_what_colours_alone_say_carries_nothing",
    ),
    Mutant(
        "dgeval/recording/messages.py",
        "unplaced = len(forces) if len(forces) != len(names) else 0",
        "unplaced = 0",
        "tests/recording/test_eighth_strangers.py::test_efforts_of_another_number_than_the_joints_are_nobodys",
    ),
    Mutant(
        "dgeval/recording/messages.py",
        "if len(names) and len(at) not in (0, len(names)):",
        "if False:",
        "tests/recording/test_eighth_strangers.py::test_positions_of_another_number_than_the_joints_are_damage",
    ),
    Mutant(
        "dgeval/recording/transforms.py",
        "            self._back.clear()\n            self._edges_ns = t_ns",
        "            self._edges_ns = t_ns",
        "tests/recording/test_eighth_strangers.py::test_what_a_tree_keeps_of_one_time_is_not_of_the_next",
    ),
    Mutant(
        "dgeval/recording/robot.py",
        "    _add_odometry(tree, scan, roles, offset)\n",
        "",
        "tests/recording/test_eighth_strangers.py::test_a_base_that_drives_by_odometry_alone_is_told",
    ),
    Mutant(
        "dgeval/recording/robot.py",
        "if float(np.ptp([pose.pose for pose in poses], axis=0).max()) <= SAME_POSE:",
        "if False:",
        "tests/recording/test_eighth_strangers.py::test_a_base_that_drives_by_odometry_alone_is_told",
    ),
    Mutant(
        "dgeval/recording/depth_unit.py",
        "if share >= LEAST_CUT else None",
        "if share else None",
        "tests/recording/test_eighth_strangers.py::test_the_farthest_reading_alone_is_no_cut",
    ),
    Mutant(
        "dgeval/verdict/judge.py",
        "if 2 * path.sd_velocity > max(DOUBTFUL_SHARE * speed, DOUBTFUL_M_S):",
        "if path.sd_velocity > max(DOUBTFUL_SHARE * speed, 0.01):",
        "tests/verdict/test_sentence.py::test_a_speed_from_few_sightings_is_told",
    ),
    Mutant(
        "dgeval/runs/target_told.py",
        "counts.lost + counts.no_depth + counts.not_started >= counts.frames - 1",
        "counts.lost + counts.no_depth >= counts.frames - 1",
        "tests/replay/test_notes.py::test_holes_are_told_where_nothing_was_measured",
    ),
    Mutant(
        "dgeval/recording/recorded_target.py",
        "if edge.child == frame]",
        "]",
        "tests/recording/test_recorded_target.py::test_the_pose_of_an_object_finds_the_thing_there",
    ),
    Mutant(
        "dgeval/recording/detections.py",
        "known = [float(v) for v in listed if 0 < v <= 1]",
        "known = [float(v) for v in listed[:1]]",
        "tests/recording/test_recorded_tracking.py::test_names_and_scores_of_detections_are_kept",
    ),
    Mutant(
        "dgeval/recording/image_codecs/raw.py",
        '    "32SC1": (np.int32, 1),',
        '    "32SC1": (np.uint8, 1),',
        "tests/recording/test_recorded_tracking.py::test_every_frame_gets_what_is_marked_in_it",
    ),
    Mutant(
        "dgeval/recording/joint_checks.py",
        "and np.ptp(q) > MOVES_FIXED:",
        "and np.ptp(q) > 9 * MOVES_FIXED:",
        "tests/recording/test_eighth_strangers.py::test_a_joint_that_moves_and_is_fixed_in_the_description_fails_its_check",
    ),
    Mutant(
        "dgeval/verdict/outcome.py",
        "(peak := _peak(log, grip)) > grip.most:",
        "(peak := _peak(log, grip)) > 99 * grip.most:",
        "tests/verdict/test_outcome.py::test_efforts_that_no_drive_gives_are_in_other_units",
    ),
    Mutant(
        "dgeval/recording/depth_edges.py",
        "        or np.abs(found).max() == FARTHEST  # no peak: it may go on rising from there\n",
        "",
        "tests/recording/test_eighth_strangers.py::test_the_best_place_at_the_border_of_the_search_is_none",
    ),
    Mutant(
        "dgeval/recording/messages.py",
        "    t_ns, unit = _in_ns(t_ns, log_ns)\n",
        '    unit = ""\n',
        "tests/recording/test_eighth_strangers.py::test_times_of_events_in_another_unit_are_told",
    ),
    Mutant(
        "dgeval/recording/messages.py",
        "    if not any(key in fields for key in LABEL_KEYS):  # a state",
        "    if False:  # a state",
        "tests/recording/test_eighth_strangers.py::test_a_label_one_level_down_is_read",
    ),
    Mutant(
        "dgeval/verdict/outcome.py",
        'if outcome != "unknown" and log.is_cut:',
        "if False:",
        "tests/verdict/test_outcome.py::test_a_log_that_ends_while_the_hand_comes_nearer_has_not_ended",
    ),
    Mutant(
        "dgeval/verdict/log.py",
        "if times is not None and max(times.arrays()[0], default=0) - last_ns > GOES_ON_NS:",
        "if times is not None:",
        "tests/verdict/test_outcome.py::test_a_log_that_ends_while_the_hand_comes_nearer_has_not_ended",
    ),
    Mutant(
        "dgeval/verdict/log.py",
        "if released_ns is None and not fingers_seen",
        "if False and not fingers_seen",
        "tests/verdict/test_outcome.py::test_a_gripper_that_is_told_to_open_lets_go",
    ),
    Mutant(
        "dgeval/recording/grippers.py",
        "if abs(float(np.interp(end, self.times, self.values)) - value) < OPENS_BY * span",
        "if False",
        "tests/recording/test_grippers.py::test_commands_that_open_are_no_closes",
    ),
    Mutant(
        "dgeval/recording/closes.py",
        "if isinstance(found, NoClose) and events.first_ns(LIFT_EVENT) is not None:",
        "if False:",
        "tests/recording/test_closes.py::test_a_lift_without_a_close_is_no_hand_that_never_closed",
    ),
    Mutant(
        "dgeval/recording/closes.py",
        "if fingers_ns is None or fingers_ns - close_ns <= EARLY_NS:",
        "if fingers_ns is None or fingers_ns - close_ns <= 9 * EARLY_NS:",
        "tests/recording/test_closes.py::test_a_close_that_is_marked_long_before_the_fingers_move",
    ),
    Mutant(
        "dgeval/recording/events.py",
        "return said.pop() if len(said) == 1 else None",
        "return min(said, default=None)",
        "tests/recording/test_eighth_strangers.py::test_labels_that_contradict_each_other_are_none",
    ),
    Mutant(
        "dgeval/verdict/draws.py",
        "BLIND_HELD * scene.held",
        "0.0 * scene.held",
        "tests/verdict/test_decide.py::test_a_held_object_that_gives_way_is_not_seen_pushed",
    ),
    Mutant(
        "dgeval/robots/dlr_hit_hand.py",
        "np.maximum(HELD_NM, OVER_NOISE * noise)",
        "HELD_NM",
        "tests/verdict/test_outcome.py::test_the_mean_of_noise_is_no_grip",
    ),
    Mutant(
        "dgeval/recording/grippers.py",
        "is_width = any(word in _last(self.topic) for word in WIDTHS)",
        "is_width = False",
        "tests/recording/test_grippers.py::test_commands_that_open_are_no_closes",
    ),
    Mutant(
        "dgeval/recording/closes.py",
        "if start in returns and risen is not None:",
        "if start in returns:",
        "tests/recording/test_grippers.py::test_a_stream_that_goes_back_to_where_it_began",
    ),
    Mutant(
        "dgeval/recording/closes.py",
        "earlier = [] if openings else changes[:k]",
        "earlier = changes[:k]",
        "tests/recording/test_grippers.py::test_which_of_two_commands_closes",
    ),
    Mutant(
        "dgeval/recording/cameras.py",
        "            and not _has(n, DISPARITY, *OF_DEPTH)\n",
        "",
        "tests/recording/test_eighth_strangers.py::test_disparity_is_no_depth",
    ),
    Mutant(
        "dgeval/recording/robot.py",
        "if any(word in TAGS for word in words):",
        "if any(tag in word for tag in TAGS for word in words):",
        "tests/recording/test_eighth_strangers.py::test_a_tag_at_the_top_of_the_tree_is_told",
    ),
    Mutant(
        "dgeval/robots/loading.py",
        "hint = next((mend for mark, mend in NO_URDF.items() if mark in text), None)",
        "hint = None",
        "tests/recording/test_eighth_strangers.py::test_a_xacro_is_named_as_one",
    ),
    Mutant(
        "dgeval/verdict/outcome.py",
        "        if near is not None and near[0] < NEAR_M:",
        "        if near is not None and near[0] < 0:",
        "tests/verdict/test_outcome.py::test_a_log_that_begins_at_the_object_may_begin_after_the_close",
    ),
    Mutant(
        "dgeval/verdict/outcome.py",
        "default=lowest) - lowest > CARRIED_M",
        "default=lowest) - lowest > 10.0",
        "tests/verdict/test_outcome.py::test_fingers_that_nothing_is_heard_of_never_closed_by_no_proof",
    ),
    Mutant(
        "dgeval/verdict/outcome.py",
        " and s.efforts.get(n) == first.efforts.get(n)\n",
        "\n",
        "tests/verdict/test_outcome.py::test_fingers_that_nothing_is_heard_of_never_closed_by_no_proof",
    ),
    Mutant(
        "dgeval/recording/messages.py",
        "    if any(key in fields for key in (EVENT_KEY, *LABEL_KEYS)):\n        return",
        "    if False:\n        return",
        "tests/recording/test_ninth_strangers.py::test_the_text_of_an_event",
    ),
    Mutant(
        "dgeval/recording/encodings/foxglove.py",
        "    if adapt is None:\n        return decode\n",
        "    if adapt is None or ros_type(name) == name:\n        return decode\n",
        "tests/recording/test_video.py::test_video_in_foxgloves_message_of_ros",
    ),
    Mutant(
        "dgeval/recording/splits.py",
        "(len(files) > 2 or own)",
        "True",
        "tests/recording/test_ninth_strangers.py::test_an_empty_file_behind_one_trial_is_no_part_of_it",
    ),
    Mutant(
        "dgeval/recording/splits.py",
        " and not set(files) <= set(read)",
        "",
        "tests/recording/test_ninth_strangers.py::test_parts_that_are_given_without_the_last_are_told",
    ),
    Mutant(
        "dgeval/recording/closing_motion.py",
        "if after - before > MOST_GAP_NS:",
        "if False:",
        "tests/recording/test_closes.py::test_a_close_in_a_hole_of_the_states_is_not_placed",
    ),
    Mutant(
        "dgeval/recording/closing_motion.py",
        "        return Inferred(*attempts[0], (after - before) * 1e-9, earlier)",
        "        return Inferred(*attempts[0], STEP_NS * 1e-9, earlier)",
        "tests/recording/test_closes.py::test_a_close_is_as_uncertain_as_its_fingers_states",
    ),
    Mutant(
        "dgeval/recording/closes.py",
        "    events = Events(tuple(e for e in events if e not in far))\n",
        "",
        "tests/recording/test_ninth_strangers.py::test_events_whose_times_are_no_times_of_the_trial_place_no_close",
    ),
    Mutant(
        "dgeval/recording/clock_checks.py",
        "    return off if agree or by_recorder else {}",
        "    return off if agree else {}",
        "tests/recording/test_ninth_strangers.py::test_the_clock_that_is_odd_is_the_one_to_set",
    ),
    Mutant(
        "dgeval/recording/checks.py",
        "told = apart is not None and (not odd or move_camera(odd, scan, robot))",
        "told = apart is not None",
        "tests/recording/test_ninth_strangers.py::test_the_clock_that_is_odd_is_the_one_to_set",
    ),
    Mutant(
        "dgeval/recording/clock_checks.py",
        "    if scan.recorder_clock is not None:  # which may run faster",
        "    if False:  # which may run faster",
        "tests/recording/test_ninth_strangers.py::test_a_recorder_that_runs_faster_is_no_clock_of_the_camera",
    ),
    Mutant(
        "dgeval/recording/roles.py",
        "if n not in states and _has_more(scan, n, told)]",
        "if not states]",
        "tests/recording/test_ninth_strangers.py::test_a_hand_that_only_its_controller_tells_of",
    ),
    Mutant(
        "dgeval/recording/robot.py",
        "    _keep_what_is_said_once(tree, description, notes)\n",
        "",
        "tests/recording/test_ninth_strangers.py::test_a_mount_that_is_on_tf_once_is_fixed",
    ),
    Mutant(
        "dgeval/recording/robot.py",
        " or any(word in child.lower() for word in TAGS):\n            continue\n        moves",
        ":\n            continue\n        moves",
        "tests/recording/test_ninth_strangers.py::test_a_tag_that_is_seen_once_stays_where_it_was_only_then",
    ),
    Mutant(
        "dgeval/recording/librealsense.py",
        ".reshape(3, 3).T\n    T[:3, 3]",
        ".reshape(3, 3)\n    T[:3, 3]",
        "tests/recording/test_ninth_strangers.py::test_the_drivers_own_extrinsics_bring_depth_into_colour",
    ),
    Mutant(
        "dgeval/recording/stamp_checks.py",
        "min(faults.duplicate, _copies(scan.times[topic]))",
        "0",
        "tests/recording/test_ninth_strangers.py::test_what_two_files_that_overlapped_hold_twice_is_no_fault",
    ),
    Mutant(
        "dgeval/recording/trials.py",
        "    if close.source is None and any",
        "    if False and any",
        "tests/recording/test_ninth_strangers.py::test_joints_that_cant_be_right_say_nothing_of_the_close",
    ),
    Mutant(
        "dgeval/recording/joint_names.py",
        "len(one[1]) < max(least, len(links & set(frames)) + 1)",
        "len(one[1]) < least",
        "tests/recording/test_joint_names.py::test_frames_that_are_the_descriptions_own_get_no_prefix",
    ),
    Mutant(
        "dgeval/recording/roles.py",
        'if not _is_unread(of.get(d.place.topic or ""))]',
        "if of]",
        "tests/recording/test_ninth_strangers.py::test_an_encoding_that_is_not_read_is_no_damage",
    ),
    Mutant(
        "dgeval/recording/inspection.py",
        "        images = images or closed\n",
        "",
        "tests/recording/test_ninth_strangers.py::test_what_is_asked_of_a_trial_that_cant_be_opened_can_not_be_told",
    ),
    Mutant(
        "dgeval/robots/described_hand.py",
        "at = meets if centre is None else transform(T_base_palm, centre[None])[0]",
        "at = meets if centre is None else centre",
        "tests/robots/test_described_hand.py::test_a_users_centre_and_approach_are_in_the_palms_frame",
    ),
    Mutant(
        "dgeval/robots/hand_geometry.py",
        "            way = way - closing * (closing @ way)\n",
        "",
        "tests/robots/test_described_hand.py::test_two_jaws_come_to_an_object_across_the_way_that_they_close",
    ),
    Mutant(
        "dgeval/planning/servo.py",
        "self._approach = hand.T_hand_palm[:3, :3].T @ hand.approach",
        "self._approach = hand.T_hand_palm[:3, :3].T[:, 2]",
        "tests/perception/test_stages.py::test_beyond_the_grasp_is_along_the_hands_own_approach",
    ),
    Mutant(
        "dgeval/robots/hand_geometry.py",
        "        on = list(itertools.takewhile(self._ahead_of_palm, on))\n",
        "",
        "tests/robots/test_described_hand.py::test_fingers_whose_limits_fold_them_through_the_palm_meet_before_it",
    ),
    Mutant(
        "dgeval/recording/inspection.py",
        '        "damage": [*closed.values(), *',
        '        "damage": [*',
        "tests/recording/test_ninth_strangers.py::test_a_folder_is_inspected_though_its_first_file_cant_be_read",
    ),
    Mutant(
        "dgeval/recording/closing_motion.py",
        "_apart(robot, tips, start - EDGE_NS, rest)",
        "_apart(robot, tips, start, rest)",
        "tests/recording/test_closes.py::test_a_close_in_a_hole_of_the_states_is_not_placed",
    ),
    Mutant(
        "dgeval/recording/closing_motion.py",
        "        if times[k + 1] - times[k] > MOST_GAP_NS:",
        "        if False:",
        "tests/recording/test_closes.py::test_fingers_that_nobody_saw_for_a_while_may_have_closed_then",
    ),
    Mutant(
        "dgeval/recording/messages.py",
        "    at_ns = _own_stamp_ns(message) if event.is_log_time else 0",
        "    at_ns = 0",
        "tests/recording/test_ninth_strangers.py::test_an_event_is_when_its_message_says",
    ),
    Mutant(
        "dgeval/recording/joint_checks.py",
        "if abs(known - value) > TWO_VALUES:",
        "if False:",
        "tests/recording/test_ninth_strangers.py::test_copies_that_are_not_alike_are_told",
    ),
    Mutant(
        "dgeval/recording/stamp_checks.py",
        "faults.duplicate >= TWICE * faults.dropped",
        "faults.duplicate >= 2 * faults.dropped",
        "tests/recording/test_ninth_strangers.py::test_copies_that_are_not_alike_are_told",
    ),
    Mutant(
        "dgeval/recording/camera.py",
        "    if unusable:\n",
        "    if False:\n",
        "tests/recording/test_ninth_strangers.py::test_whose_matrix_is_used_for_a_camera_without_one_is_said",
    ),
    Mutant(
        "dgeval/recording/image_codecs/depth_png.py",
        "other = up if by_up <= by_corner else corner",
        "other = up if by_up < by_corner else corner",
        "tests/recording/test_depth_png.py",
    ),
    Mutant(
        "dgeval/recording/image_codecs/depth_png.py",
        'if zlib.crc32(body) != int.from_bytes(data[end - 4 : end], "big"):',
        "if zlib.crc32(body) == -1:",
        "tests/recording/test_depth_png.py",
    ),
    Mutant(
        "dgeval/recording/image_codecs/depth_png.py",
        "        elif kind not in WITHOUT_MEANING:",
        '        elif kind == b"gAMA":',
        "tests/recording/test_depth_png.py",
    ),
    Mutant(
        "dgeval/recording/image_codecs/depth_png.py",
        "(np.uint16(row[2 * x]) << 8) | row[2 * x + 1]",
        "(np.uint16(row[2 * x + 1]) << 8) | row[2 * x]",
        "tests/recording/test_depth_png.py",
    ),
    Mutant(
        "dgeval/recording/containers/mcap.py",
        "            if chunk.uncompressed_crc != found:",
        "            if chunk.uncompressed_crc == -found:",
        "tests/recording/test_damage.py",
    ),
    Mutant(
        "dgeval/verdict/outcome.py",
        'if shown.source == "inferred" and shown.outcome != log.label:',
        "if False:",
        "tests/verdict/test_outcome.py",
    ),
    Mutant(
        "dgeval/verdict/sentence.py",
        "    if share >= RARELY:",
        "    if share >= 0.0:",
        "tests/verdict/test_sentence.py",
    ),
    Mutant(
        "dgeval/verdict/judge.py",
        "way < UNLIKE_THE_WHOLE * speed * lasted_s",
        "way < 0.0",
        "tests/verdict/test_sentence.py",
    ),
    Mutant(
        "dgeval/recording/joint_checks.py",
        "    if len(shared) <= STRAY * stamps:",
        "    if not apart:",
        "tests/recording/test_ninth_strangers.py",
    ),
    Mutant(
        "dgeval/recording/joint_names.py",
        'len(frames) == 1 and one[0].endswith("/")',
        "len(frames) == 1",
        "tests/recording/test_joint_names.py",
    ),
    Mutant(
        "dgeval/recording/inspection.py",
        '            "" if said or presses else seen,',
        '            "",',
        "tests/recording/test_ninth_strangers.py",
    ),
    Mutant(
        "dgeval/recording/scan.py",
        "_count_words(out.words[message.topic], opened.decode(message))\n        except",
        "pass\n        except",
        "tests/recording/test_ninth_strangers.py",
    ),
    Mutant(
        "dgeval/verdict/draws.py",
        "    narrow, wide = np.exp(-0.5 * square), np.exp(-0.125 * square) / 8",
        "    narrow, wide = np.exp(-0.5 * square), np.exp(-0.125 * square)",
        "tests/verdict/test_decide.py",
    ),
    Mutant(
        "dgeval/recording/cameras.py",
        "trees = (_parents(scan, _ways(scan)), _parents(scan, None))",
        "trees = (_parents(scan, None), _parents(scan, None))",
        "tests/recording/test_several_robots.py",
    ),
    Mutant(
        "dgeval/recording/robot.py",
        "if any(frame in tree.moving and _changes(tree.moving[frame][1]) for frame in above):",
        "if any(frame in tree.moving for frame in above):",
        "tests/recording/test_seventh_strangers.py",
    ),
    Mutant(
        "dgeval/recording/clock_checks.py",
        "        end = (log >= last - quarter) & (log <= last)",
        "        end = log >= log.max() - quarter",
        "tests/recording/test_seventh_strangers.py",
    ),
    Mutant(
        "dgeval/recording/depth_unit.py",
        "votes.append(as_read < inverse)",
        "votes.append(as_read > inverse)",
        "tests/recording/test_depth_unit.py",
    ),
    Mutant(
        "dgeval/recording/depth_unit.py",
        "replace(f, depth=_inverted(f.depth)) for f",
        "replace(f, depth=f.depth) for f",
        "tests/recording/test_depth_unit.py",
    ),
    Mutant(
        "dgeval/recording/depth_edges.py",
        "    if shrunk < 1.0:\n",
        "    if shrunk < 0.1:\n",
        "tests/recording/test_depth_edges.py",
    ),
    Mutant(
        "dgeval/recording/closes.py",
        "max((t for t in closes if t < last), default=None)",
        "max((t for t in closes if t > last), default=None)",
        "tests/recording/test_closes.py",
    ),
    Mutant(
        "dgeval/replay/target_search.py",
        "begin = sum(t <= (trial.close.before_ns or 0) for t in stamps)",
        "begin = 0",
        "tests/replay/test_target_search.py",
    ),
    Mutant(
        "dgeval/recording/checks.py",
        "    if roles.target or not listed:\n",
        "    if not listed:\n",
        "tests/recording/test_recorded_target.py",
    ),
    Mutant(
        "dgeval/recording/camera_poses.py",
        "pose_from_matrix(T_BODY_OPTICAL)",
        "pose_from_matrix(invert(T_BODY_OPTICAL))",
        "tests/recording/test_camera_poses.py",
    ),
    Mutant(
        "dgeval/robots/hand_geometry.py",
        "SHARES = (0.1, 0.25, 0.5)",
        "SHARES = (0.1,)",
        "tests/robots/test_described_hand.py",
    ),
    Mutant(
        "dgeval/robots/loading.py",
        "repr(length + 2 * radius)",
        "repr(length)",
        "tests/robots/test_link_shapes.py",
    ),
    Mutant(
        "dgeval/robots/hand_links.py",
        'if above is None or above.kind == "fixed":',
        'if above is None or above.kind != "fixed":',
        "tests/robots/test_hand_links.py",
    ),
    Mutant(
        "dgeval/verdict/evidence.py",
        'elif gripper.closing_source == "limits" and not gripper.geometry.closes:',
        'elif gripper.closing_source == "set" and not gripper.geometry.closes:',
        "tests/verdict/test_evidence.py",
    ),
    Mutant(
        "dgeval/robots/mjcf_description.py",
        'return bool(first[1].tag == "mujoco")',
        'return bool(first[1].tag != "robot")',
        "tests/robots/test_mjcf_description.py",
    ),
    Mutant(
        "dgeval/robots/hand_geometry.py",
        'if reach > BAR * most or sum(joints[k].kind != "fixed" for k in end) > 1',
        "if reach > BAR * most",
        "tests/robots/test_described_hand.py",
    ),
    Mutant(
        "dgeval/robots/link_shapes.py",
        'is_knuckle = not ends and any(joint.kind != "fixed" for joint in below)',
        "is_knuckle = False",
        "tests/robots/test_described_hand.py",
    ),
    Mutant(
        "dgeval/robots/mjcf_description.py",
        "if sum(name not in direct for name in along) > 1:",
        "if True:",
        "tests/robots/test_mjcf_description.py",
    ),
    Mutant(
        "dgeval/robots/mjcf_description.py",
        'if compiler is not None and compiler.get("angle") is not None:',
        "if compiler is not None:",
        "tests/robots/test_mjcf_description.py",
    ),
    Mutant(
        "dgeval/recording/frame_checks.py",
        "*([] if hand.is_told else [HAND_UNTESTED])",
        "*([] if hand.is_off else [HAND_UNTESTED])",
        "tests/recording/test_hand_seen.py",
    ),
    Mutant(
        "dgeval/recording/hand_seen.py",
        "    if len(views) < LEAST_FRAMES:\n        return HandSeen(False)",
        "    if len(views) < LEAST_FRAMES:\n        return HandSeen(True)",
        "tests/recording/test_hand_seen.py",
    ),
    Mutant(
        "dgeval/verdict/judge.py",
        "if len(log.untested) < 2 or not _is_of_pose(decision):",
        "if not log.untested or not _is_of_pose(decision):",
        "tests/verdict/test_sentence.py",
    ),
    Mutant(
        "dgeval/verdict/evidence.py",
        "points[:, 2] -= _risen_unseen(",
        "points[:, 2] += _risen_unseen(",
        "tests/verdict/test_evidence.py",
    ),
    Mutant(
        "dgeval/verdict/evidence.py",
        "    if times.start < lifted_ns:",
        "    if end_ns < lifted_ns:",
        "tests/verdict/test_evidence.py",
    ),
    Mutant(
        "dgeval/verdict/recorded_closing.py",
        "< STILL_CLOSED * stood)).any())",
        "< 0.0 * stood)).any())",
        "tests/verdict/test_described_grip.py",
    ),
    Mutant(
        "dgeval/verdict/recorded_closing.py",
        "lower = np.where(until < closing.before, np.maximum(lower, until), lower)",
        "pass",
        "tests/verdict/test_described_grip.py",
    ),
    Mutant(
        "dgeval/runs/estimates.py",
        "closing = Closing(np.array(c.before), np.array(c.way), np.array(c.speeds), until)",
        "closing = Closing(np.array(c.before), np.array(c.way), np.array(c.speeds))",
        "tests/verdict/test_estimates.py",
    ),
    Mutant(
        "dgeval/recording/containers/opening.py",
        "if (there := held.get(name, 0)) is not None and there < count",
        "if (there := held.get(name, 0)) is not None and there > count",
        "tests/recording/test_lost_parts.py",
    ),
    Mutant(
        "dgeval/recording/containers/opening.py",
        "lost_to_ns=None if stop is None or start is None else stop[0],",
        "lost_to_ns=None,",
        "tests/recording/test_lost_parts.py",
    ),
    Mutant(
        "dgeval/recording/containers/opening.py",
        "start = ends[before - 1] if before else None",
        "start = ends[before] if before < len(ends) else None",
        "tests/recording/test_lost_parts.py",
    ),
    Mutant(
        "dgeval/recording/splits.py",
        "if theirs is None or own.topics.keys() & other.topics.keys():",
        "if theirs is None:",
        "tests/recording/test_lost_parts.py",
    ),
    Mutant(
        "dgeval/recording/splits.py",
        "return found[0] if len(found) == 1 else None",
        "return found[0] if found else None",
        "tests/recording/test_lost_parts.py",
    ),
    Mutant(
        "dgeval/recording/splits.py",
        "if shared > MOSTLY * min(",
        "if shared < MOSTLY * min(",
        "tests/recording/test_lost_parts.py",
    ),
    Mutant(
        "dgeval/recording/closing_motion.py",
        "return k + int(before[-1]) + 1 if len(before) else k",
        "return k",
        "tests/recording/test_closes.py::test_fingers_that_give_way_before_they_close",
    ),
    Mutant(
        "dgeval/recording/closing_motion.py",
        "np.cumsum(way) > IN_EARNEST",
        "np.cumsum(way) > 0.9",
        "tests/recording/test_closes.py::test_fingers_that_give_way_before_they_close",
    ),
    Mutant(
        "dgeval/recording/closing_motion.py",
        "> GOES_ON * moved[first",
        "> 9.0 * moved[first",
        "tests/recording/test_closes.py::test_fingers_that_curl_past_each_other",
    ),
    Mutant(
        "dgeval/recording/closing_motion.py",
        "min() > GOES_ON",
        "min() > -GOES_ON",
        "tests/recording/test_closes.py::test_fingers_that_curl_past_each_other",
    ),
    Mutant(
        "dgeval/recording/closing_motion.py",
        "apart[ranges >= PARTS * ranges.max()]",
        "apart[ranges >= 0.0]",
        "tests/recording/test_closes.py::test_the_bars_of_a_linkage_hide_no_close",
    ),
    Mutant(
        "dgeval/verdict/outcome.py",
        "if near is None or near[0] >= NEAR_M:",
        "if True:",
        "tests/verdict/test_outcome.py::test_a_hand_that_rises_from_the_object_may_have_closed_on_it",
    ),
    Mutant(
        "dgeval/verdict/outcome.py",
        "if seen is not None and not seen[0]:",
        "if False:",
        "tests/verdict/test_outcome.py::test_a_hand_that_rises_from_the_object_may_have_closed_on_it",
    ),
    Mutant(
        "dgeval/verdict/outcome.py",
        "if near is None or near[0] < NEAR_M:",
        "if False:",
        "tests/verdict/test_outcome.py::test_fingers_that_move_far_from_the_object_take_a_shape",
    ),
    Mutant(
        "dgeval/verdict/outcome.py",
        "if log.released_ns is None else RELEASED_S",
        "if log.released_ns is None else AFTER_S",
        "tests/verdict/test_outcome.py",
    ),
    Mutant(
        "dgeval/verdict/evidence.py",
        "until = min([*met, end_ns])",
        "until = end_ns",
        "tests/verdict/test_evidence.py::test_what_the_hand_topples_is_held_by_nobody",
    ),
    Mutant(
        "dgeval/verdict/draws.py",
        "BLIND_DESCRIBED = 0.15",
        "BLIND_DESCRIBED = 0.0",
        "tests/verdict/test_decide.py::test_a_hand_by_its_description_is_never_as_sure_as_its_draws",
    ),
    Mutant(
        "dgeval/evaluate/agreement.py",
        'if self.outcome == "failure" else NO_FAILURE',
        "if True else NO_FAILURE",
        "tests/evaluate/test_agreement.py",
    ),
    Mutant(
        "dgeval/evaluate/agreement.py",
        " + (1.0 - sum(p)) ** 2",
        "",
        "tests/evaluate/test_agreement.py::test_the_brier_score",
    ),
    Mutant(
        "dgeval/evaluate/agreement.py",
        "key=lambda t: (-_sure(t), t.arm, t.trial)",
        "key=lambda t: (t.arm, t.trial)",
        "tests/evaluate/test_agreement.py::test_the_surest_mistake_comes_first",
    ),
    Mutant(
        "dgeval/evaluate/words.py",
        'trials["cause_given"].notna()',
        'trials["trial"].notna()',
        "tests/evaluate/test_agreement.py::test_a_run_beside_peoples_words",
    ),
    Mutant(
        "dgeval/simulation/physics.py",
        "m.body_mass[body] *= self.mass",
        "pass",
        "tests/simulation/test_varied_physics.py",
    ),
    Mutant(
        "dgeval/simulation/physics.py",
        "m.geom_friction[g, 0] *= self.friction",
        "pass",
        "tests/simulation/test_varied_physics.py",
    ),
    Mutant(
        "dgeval/simulation/campaign.py",
        "plan.physics.put(world)",
        "pass",
        "tests/simulation/test_varied_physics.py",
    ),
    Mutant(
        "dgeval/cli/replay.py",
        "if note not in r.messages:",
        "if True:",
        "tests/replay/test_printed.py",
    ),
    Mutant(
        "dgeval/schema.py",
        'NOTES_APART = " | "',
        'NOTES_APART = "; "',
        "tests/replay/test_printed.py",
    ),
    Mutant(
        "dgeval/recording/cameras.py",
        "_has(n, DISPARITY, *OF_DEPTH)",
        "_has(n, DISPARITY)",
        "tests/recording/test_tenth_strangers.py::test_how_good_depth_is_is_no_depth",
    ),
    Mutant(
        "dgeval/recording/joint_checks.py",
        "steps[after] > MAKES_UP * usual",
        "steps[after] > 0.0",
        "tests/recording/test_tenth_strangers.py::test_an_arm_whose_driver_hangs_while_it_moves",
    ),
    Mutant(
        "dgeval/recording/joint_checks.py",
        "if lasts_s < HANGS_S or before + 1 < STEPS:",
        "if True:",
        "tests/recording/test_tenth_strangers.py::test_an_arm_whose_driver_hangs_while_it_moves",
    ),
    Mutant(
        "dgeval/recording/scan.py",
        "and all(tag in text for tag in URDF_TAGS)",
        "and '<robot' in text",
        "tests/recording/test_tenth_strangers.py::test_the_description_by_its_name_goes_before_others",
    ),
    Mutant(
        "dgeval/recording/robot.py",
        "return not by_name, not is_home",
        "return not is_home",
        "tests/recording/test_tenth_strangers.py::test_the_description_by_its_name_goes_before_others",
    ),
    Mutant(
        "dgeval/verdict/outcome.py",
        "_is_commanded(rows) if holds[0] else _falls_away(log, grip, last_ns)",
        "False",
        "tests/verdict/test_outcome.py::test_equal_efforts_of_all_fingers_are_commanded_ones",
    ),
    Mutant(
        "dgeval/verdict/outcome.py",
        "return is_seen and bool",
        "return False and bool",
        "tests/verdict/test_outcome.py::test_efforts_are_judged_by_their_mean_over_the_last_half_second",
    ),
    Mutant(
        "dgeval/recording/closing_motion.py",
        "(back >= REOPENED) & (times > lift_ns)",
        "(back >= 9.0) & (times > lift_ns)",
        "tests/recording/test_closes.py::test_a_hand_that_opens_and_closes_again_after_its_lift",
    ),
]


def copy_tracked(target: Path) -> None:
    """The tracked files as they are in the working tree, of data sets the demo and the renderer."""
    data = ("datasets/demo.mcap", "datasets/raycast.py")
    kept = ("dgeval", "benchmarks", "tests", "pyproject.toml", *data)
    command = ["git", "ls-files", "-z", *kept]
    listed = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=True).stdout
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target / name)


def run_python(tree: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Python in the copy, with no compiled files: they would outlive a fault of the same size."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    environment["PYTHONDONTWRITEBYTECODE"] = "1"
    command = [sys.executable, *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, cwd=tree, env=environment, check=False
    )


def run_tests(tree: Path, *tests: str) -> tuple[int, str]:
    """Pytest's exit code, 0 passed and 1 failed, and the end of what it printed."""
    done = run_python(tree, "-m", "pytest", *tests, "-x", "--tb=no", "-m", "not slow")
    return done.returncode, "\n".join((done.stdout + done.stderr).splitlines()[-5:])


def misfit(tree: Path, mutants: list[Mutant]) -> str | None:
    """Why nothing can be learnt from these mutants; None where they fit and their tests pass."""
    place = run_python(tree, "-c", "import dgeval; print(dgeval.__file__)").stdout.strip()
    if not Path(place).resolve().is_relative_to(tree.resolve()):
        return f"the tests would import {place}, not the copy"
    for m in mutants:
        count = (tree / m.file).read_text(encoding="utf-8").count(m.old)
        if count != 1:
            return f"stands {count} times in {m.file}, not once: {m.old!r}"
    code, printed = run_tests(tree, *sorted({m.test for m in mutants}))
    return f"the tests fail without a fault:\n{printed}" if code else None


def survives(tree: Path, mutant: Mutant) -> bool | str:
    """Whether the test passes all the same; in words, what kept it from running."""
    path = tree / mutant.file
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace(mutant.old, mutant.new), encoding="utf-8")
    try:
        code, printed = run_tests(tree, mutant.test)
    finally:
        path.write_text(text, encoding="utf-8")
    return code == 0 if code in (0, 1) else printed


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    some = parser.add_mutually_exclusive_group()
    some.add_argument("--only", type=int, metavar="N", help="this mutant alone, from 0")
    some.add_argument("--few", action="store_true", help=f"the first {FEW} alone")
    args = parser.parse_args()
    numbers = list(range(len(MUTANTS)))[: FEW if args.few else None]
    if args.only is not None:
        if args.only not in numbers:
            parser.error(f"--only takes 0 to {len(MUTANTS) - 1}")
        numbers = [args.only]
    survivors = broken = 0
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        tree = Path(folder)
        copy_tracked(tree)
        why = misfit(tree, [MUTANTS[n] for n in numbers])
        if why is not None:
            print(why)
            return 2
        for n in numbers:
            m = MUTANTS[n]
            found = survives(tree, m)
            told = "BROKEN" if isinstance(found, str) else "SURVIVED" if found else "killed"
            survivors += found is True
            broken += isinstance(found, str)
            print(f"{n:3d} {told:8s} {m.file}: {m.old.strip()!r} -> {m.new.strip()!r}", flush=True)
            if told != "killed":
                print(f"    by {m.test}" if found is True else f"    {found}", flush=True)
    print(f"{len(numbers)} mutants, {survivors} survived, {broken} could not be tested")
    return 1 if survivors else 2 if broken else 0


if __name__ == "__main__":
    raise SystemExit(main())
