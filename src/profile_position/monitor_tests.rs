//! What one set-point makes of what an axis shows, at each bound and one beside it.

use core::time::Duration;

use crate::{
    ds402::{Controlword, Mode, Sample, Statusword},
    profile_position::{
        LastSeen, Limits, MoveCommand, PositionRange, RelativeBase, SetPoint, Standstill, Traits,
    },
};

use super::{drive_buffer_tests::raised, *};

const WINDOW: i32 = 10;
const SETTLE: Duration = ms(100);
const BEGIN: Duration = ms(1_000);
/// Where the clock of a scene stands.
const NOW: Duration = ms(20_000);

const fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

/// One cycle of an axis.
struct Scene {
    now: Duration,
    position: i32,
    word: Statusword,
    standstill: Standstill,
    bounds: Bounds,
    traits: Traits,
    delivered: bool,
    blind: u32,
    bit_11_is_valid: bool,
}

impl Scene {
    /// In motion, with bit 10 low.
    fn at(position: i32) -> Self {
        Self {
            now: NOW,
            position,
            word: Statusword::empty(),
            standstill: Standstill::default(),
            bounds: Bounds::new(WINDOW as u32, Some(0), SETTLE, ms(1), None),
            traits: Traits::cia402(),
            delivered: true,
            blind: 0,
            bit_11_is_valid: true,
        }
    }

    /// At rest there for as long as this, with bit 10 high.
    fn rests(position: i32, time: Duration) -> Self {
        let mut this = Self::at(position);
        this.word = Statusword::TARGET_REACHED;
        let first = (NOW - time).as_millis() as u64;
        for at in first..=NOW.as_millis() as u64 {
            this.standstill.update(ms(at), position, None, &this.bounds);
        }
        this
    }

    /// On an axis that turns in 3600 counts.
    fn turning(position: i32) -> Self {
        let turn = PositionRange { min: 0, max: 3_599 };
        Self {
            bounds: Bounds::new(WINDOW as u32, Some(0), SETTLE, ms(1), Some(turn)),
            ..Self::at(position)
        }
    }

    fn shows<R>(&self, of: impl FnOnce(&Cycle<'_>) -> R) -> R {
        let sample = Sample {
            statusword: self.word,
            mode: Mode::ProfilePosition,
            position: self.position,
            velocity: None,
            error_code: None,
        };
        of(&Cycle {
            now: self.now,
            sample: &sample,
            standstill: &self.standstill,
            bounds: &self.bounds,
            last_seen: &LastSeen::default(),
            traits: &self.traits,
            limits: &Limits::trust_drive(),
            referenced: true,
            delivered: self.delivered,
            halted: false,
            blind: self.blind,
            stalled: 0,
            bit_11_is_valid: self.bit_11_is_valid,
            acknowledge: ms(500),
            begin: BEGIN,
            controlword: Controlword::empty(),
        })
    }
}

/// A move with the drive's own parameters.
const fn command(reference: Reference, target: i32) -> MoveCommand {
    MoveCommand {
        reference,
        target,
        set_point: SetPoint::new(),
        gated: false,
    }
}

/// A set-point that an axis at rest at 0 has begun a second after the clock began.
fn begun(scene: &Scene, reference: Reference, target: i32, end: Option<i32>) -> SetPointMonitor {
    let raised = raised(1, command(reference, target), end);
    let scene = Scene {
        now: ms(1_000),
        position: 0,
        standstill: Standstill::default(),
        ..*scene
    };
    let mut monitor = scene.shows(|cycle| SetPointMonitor::new(&raised, true, cycle));
    monitor.unlimited = true;
    monitor
}

/// The same to this position.
fn to(end: i32) -> SetPointMonitor {
    begun(&Scene::at(0), Reference::Absolute, end, Some(end))
}

/// A distance that leads nobody knows where, from a base that is not known better than this.
fn distance(way: i32, bases: Bases) -> SetPointMonitor {
    let mut monitor = begun(&Scene::at(0), Reference::Relative, way, None);
    monitor.bases = bases;
    monitor
}

/// The base is at this position, for all that is known.
const fn base(position: i32) -> Bases {
    Bases {
        previous: None,
        beside: 0,
        position,
        slack: 0,
        is_own: false,
    }
}

fn changed(
    mut monitor: SetPointMonitor,
    change: impl FnOnce(&mut SetPointMonitor),
) -> SetPointMonitor {
    change(&mut monitor);
    monitor
}

#[test]
fn the_way_until_the_acknowledge_is_not_that_of_one_cycle() {
    let raised = raised(1, command(Reference::Absolute, 260), Some(260));
    Scene::at(140).shows(|cycle| {
        let mut monitor = SetPointMonitor::new(&raised, true, cycle);
        monitor.note(cycle, true);
        assert!(!monitor.near && monitor.remaining == 120);
    });
    Scene::at(270).shows(|cycle| {
        let mut monitor = SetPointMonitor::new(&raised, true, cycle);
        monitor.note(cycle, true);
        assert!(monitor.near);
    });
}

#[test]
fn an_axis_lingers_once_two_spans_have_the_same_bounds() {
    let lingers = |first: (i32, i32), second: (i32, i32)| {
        let mut lingering = Lingering::default();
        let since = (0..=2_001).find(|&at| {
            let (low, high) = if at <= 1_000 { first } else { second };
            let mut scene = Scene::at(if at % 2 == 0 { low } else { high });
            scene.now = ms(at);
            scene.shows(|cycle| lingering.update(cycle))
        });
        (since, lingering.width())
    };
    assert_eq!(lingers((0, 30), (0, 30)), (Some(2_001), 30));
    assert_eq!(lingers((0, 30), (10, 40)), (Some(2_001), 30));
    assert_eq!(lingers((0, 30), (-10, 20)), (Some(2_001), 30));
    assert_eq!(lingers((0, 30), (11, 40)), (None, 29));
    assert_eq!(lingers((0, 30), (10, 41)), (None, 31));
    assert_eq!(Lingering::default().width(), 0);
}

#[test]
fn a_distance_may_end_as_far_from_its_base_as_that_is_vague() {
    let bounds = Scene::at(0).bounds;
    let vague = Bases {
        slack: 5,
        ..base(0)
    };
    let before = Bases {
        previous: Some(200),
        ..base(0)
    };
    let beside = Bases {
        beside: 5,
        ..before
    };
    for (bases, position, leads, all_lead) in [
        (base(0), 110, true, true),
        (base(0), 90, true, true),
        (base(0), 111, false, false),
        (base(0), 89, false, false),
        (vague, 115, true, false),
        (vague, 116, false, false),
        (before, 110, true, false),
        (before, 290, true, false),
        (before, 310, true, false),
        (before, 311, false, false),
        (beside, 315, true, false),
        (beside, 316, false, false),
    ] {
        assert_eq!(bases.lead_to(position, 100, &bounds), leads, "{position}");
        let all = bases.all_lead_to(position, 100, &bounds);
        assert_eq!(all, all_lead, "{position}");
    }
    // What is vague by no more than the window is within it.
    let slack = |slack| Bases { slack, ..base(0) };
    assert!(slack(10).all_lead_to(110, 100, &bounds));
    assert!(slack(15).all_lead_to(105, 100, &bounds));
    assert!(!slack(15).all_lead_to(106, 100, &bounds));
    let near = Bases {
        previous: Some(5),
        ..base(0)
    };
    assert!(near.all_lead_to(110, 100, &bounds));
    assert!(!near.all_lead_to(94, 100, &bounds));
}

#[test]
fn an_axis_that_is_where_its_distance_counts_from_has_gone_none() {
    let bounds = Scene::at(0).bounds;
    let own = Bases {
        slack: 1_000,
        is_own: true,
        ..base(0)
    };
    for (position, way, leads) in [
        (10, 21, false),
        (-10, -21, false),
        (10, 20, true),
        (10, -20, true),
        (11, 21, true),
    ] {
        assert_eq!(own.lead_to(position, way, &bounds), leads, "{position}");
    }
    let of_another = Bases {
        is_own: false,
        ..own
    };
    assert!(of_another.lead_to(10, 21, &bounds));
}

#[test]
fn the_end_before_is_near_within_three_windows_or_the_lag() {
    let bounds = Scene::at(0).bounds;
    let after = |previous| Bases {
        previous,
        ..base(0)
    };
    for (previous, lag, near) in [
        (None, 0, true),
        (Some(30), 0, true),
        (Some(-31), 0, false),
        (Some(31), 31, true),
        (Some(32), 31, false),
    ] {
        assert_eq!(after(previous).are_near(lag, &bounds), near, "{previous:?}");
    }
    assert_eq!([lag_of(-400), lag_of(3)], [100, 0]);
}

#[test]
fn a_base_is_as_vague_as_an_axis_in_motion_has_gone_eight_times() {
    let slack = |scene: &Scene, from_rest| {
        scene.shows(|cycle| Bases::of(0, Some(7), None, from_rest, cycle).slack)
    };
    let moving = Scene::at(5);
    assert_eq!(slack(&moving, false), 50);
    assert_eq!(slack(&moving, true), 10);
    let standing = Scene::rests(5, ms(200));
    assert_eq!(slack(&standing, false), 10);
    let of = moving.shows(|cycle| Bases::of(2, Some(7), None, false, cycle));
    assert!(of.is_own);
    let behind = of.after(100, &moving.bounds);
    assert_eq!((behind.previous, behind.position), (Some(107), 102));
    assert_eq!((behind.slack, behind.is_own), (of.slack + 10, false));
}

#[test]
fn what_replaces_a_distance_without_an_end_may_count_from_where_that_would_have_ended() {
    let first = Bases {
        slack: 20,
        ..base(100)
    };
    let third = Bases {
        previous: Some(50),
        beside: 10,
        ..first
    };
    for (previous, replaced, counts_from) in [
        (None, None, (None, 0)),
        (None, Some(first), (Some(100), 20)),
        (None, Some(third), (Some(50), 10)),
        (Some(7), Some(third), (Some(7), 0)),
    ] {
        let of = Scene::at(0).shows(|cycle| Bases::of(0, previous, replaced, false, cycle));
        assert_eq!((of.previous, of.beside), counts_from);
    }
}

#[test]
fn a_distance_is_loose_unless_its_base_is_documented_or_the_axis_is_far_from_the_end_before() {
    let far = Bases {
        previous: Some(101),
        ..base(0)
    };
    for (bases, relative_base, far_behind, loose) in [
        (far, RelativeBase::PreviousTarget, false, false),
        (far, RelativeBase::Undocumented, false, true),
        (far, RelativeBase::Undocumented, true, false),
        (base(0), RelativeBase::Undocumented, true, true),
    ] {
        let mut scene = Scene::at(0);
        scene.traits.relative_base = relative_base;
        // A quarter of the way is what it may lag behind.
        let mut monitor = distance(400, bases);
        monitor.end = Some(400);
        let is_loose = |monitor: &SetPointMonitor| {
            scene.shows(|cycle| monitor.is_loose_on(far_behind.then_some(0), cycle))
        };
        assert_eq!(is_loose(&monitor), loose, "{relative_base:?} {far_behind}");
        monitor.end = None;
        assert!(is_loose(&monitor));
        monitor.distance = None;
        assert!(!is_loose(&monitor), "a position");
    }
}

#[test]
fn one_that_is_loose_or_behind_such_a_one_may_end_beside() {
    for (is_loose, is_vague) in [(false, false), (false, true), (true, false)] {
        let monitor = changed(to(100), |monitor| {
            (monitor.is_loose, monitor.is_vague) = (is_loose, is_vague);
        });
        assert_eq!(monitor.may_end_beside(), is_loose || is_vague);
    }
}

#[test]
fn what_one_behind_it_counts_from_is_known_of_a_distance_without_an_end() {
    let bounds = Scene::at(0).bounds;
    let behind = distance(400, base(5)).bases_behind(&bounds);
    assert_eq!(behind.map(|bases| bases.position), Some(405));
    let known = changed(distance(400, base(5)), |monitor| monitor.end = Some(405));
    assert!(known.bases_behind(&bounds).is_none());
}

#[test]
fn a_set_point_has_begun_when_it_moved_the_axis_or_bit_10_was_low_for_it() {
    let begun = |position: i32, change: fn(&mut SetPointMonitor)| {
        let monitor = changed(to(1_000), change);
        Scene::at(position).shows(|cycle| monitor.has_begun(cycle))
    };
    assert!(!begun(10, |_| ()));
    assert!(begun(11, |_| ()));
    assert!(begun(12, |_| ()));
    assert!(begun(0, |monitor| monitor.left_target = true));
    assert!(!begun(0, |monitor| {
        (monitor.left_target, monitor.follows) = (true, true);
    }));
    // Where it was not seen to stand, it has begun in motion; but not one that was to begin at rest, nor one whose motion may be that
    // of another.
    assert!(begun(0, |monitor| (monitor.stood, monitor.from_rest) =
        (None, false)));
    assert!(!begun(0, |monitor| (monitor.stood, monitor.from_rest) =
        (None, true)));
    assert!(!begun(0, |monitor| {
        (monitor.stood, monitor.from_rest, monitor.doubted) = (None, false, true);
    }));
    assert!(!begun(0, |monitor| {
        (monitor.stood, monitor.from_rest) = (None, false);
        (monitor.by_room, monitor.short) = (true, true);
    }));
    assert!(begun(0, |monitor| {
        (monitor.stood, monitor.from_rest) = (None, false);
        (monitor.by_room, monitor.short) = (true, false);
    }));
    assert!(begun(0, |monitor| {
        (monitor.stood, monitor.from_rest) = (None, false);
        (monitor.by_room, monitor.short) = (false, true);
    }));
}

#[test]
fn behind_one_that_may_begin_yet_a_set_point_is_the_first_once_it_has_begun() {
    let first = |position: i32, after_unseen| {
        let monitor = changed(to(1_000), |monitor| monitor.after_unseen = after_unseen);
        Scene::at(position).shows(|cycle| monitor.is_surely_first(cycle))
    };
    assert!(first(0, false));
    assert!(!first(0, true));
    assert!(first(11, true));
}

#[test]
fn one_that_comes_to_its_end_late_was_no_motion_of_the_next() {
    let came = |seen_there, stood| {
        let before = changed(to(100), |monitor| monitor.seen_there = seen_there);
        let mut next = changed(to(1_000), |monitor| monitor.stood = stood);
        Scene::at(50).shows(|cycle| next.came_to_end_of(&before, cycle));
        (next.stood, next.length)
    };
    assert_eq!(came(true, Some(20)), (Some(100), 900));
    assert_eq!(came(false, Some(20)), (Some(20), 1_000));
    assert_eq!(came(true, None), (None, 1_000));
}

#[test]
fn the_next_begins_where_the_one_before_was_seen_to_end() {
    let taken_over = |seen_there, loose, rests| {
        let before = changed(to(100), |monitor| {
            (monitor.seen_there, monitor.is_loose) = (seen_there, loose);
            monitor.fastest = 77;
        });
        let mut next = changed(to(1_000), |monitor| {
            monitor.from_rest = false;
            monitor.swings = true;
            (monitor.near, monitor.arrived, monitor.unseen) = (true, Some(995), 55);
        });
        Scene::at(50).shows(|cycle| next.takes_over(&before, true, rests, cycle));
        assert!(next.follows && next.by_room && !next.swings);
        assert_eq!((next.near, next.arrived), (true, Some(995)));
        assert_eq!((next.unseen, next.fastest), (55, 77));
        assert_eq!(next.remaining, 950);
        (next.stood, next.length)
    };
    assert_eq!(taken_over(true, false, false), (None, 900));
    assert_eq!(taken_over(true, false, true), (Some(100), 900));
    assert_eq!(taken_over(true, true, true), (Some(50), 900));
    assert_eq!(taken_over(false, false, true), (Some(50), 950));
    assert_eq!(taken_over(false, false, false), (None, 950));
    // One that begins at rest stood there.
    let before = changed(to(100), |monitor| monitor.seen_there = true);
    let mut next = to(1_000);
    Scene::at(50).shows(|cycle| next.takes_over(&before, true, false, cycle));
    assert_eq!(next.stood, Some(100));
}

#[test]
fn a_set_point_that_begins_at_rest_on_an_axis_that_stands_stood_there() {
    for (from_rest, stands, stood) in [
        (true, true, Some(7)),
        (true, false, None),
        (false, true, None),
    ] {
        let mut monitor = changed(to(1_000), |monitor| monitor.from_rest = from_rest);
        Scene::at(7).shows(|cycle| monitor.becomes_active(cycle, 7, stands));
        assert_eq!(monitor.stood, stood);
    }
}

#[test]
fn a_resumed_set_point_begins_where_the_axis_is_then() {
    let mut monitor = changed(to(1_000), |monitor| {
        monitor.left_target = true;
        monitor.halt_told = true;
        monitor.arrived = Some(1_000);
        monitor.resting = Some(NOW);
        monitor.left_place = Some(NOW);
    });
    monitor.goes_on(NOW, false, true);
    assert!(!monitor.from_rest && monitor.overshoots);
    assert!(!monitor.left_target && !monitor.halt_told);
    assert_eq!(
        (monitor.arrived, monitor.resting, monitor.left_place),
        (None, None, None)
    );
    monitor.goes_on(NOW, true, true);
    assert!(monitor.from_rest && !monitor.overshoots);
    // One behind it begins as it was to.
    monitor.goes_on(NOW, false, false);
    assert!(monitor.from_rest && !monitor.overshoots);
    // Bit 10 counts from when the drive has surely seen the low of bit 8.
    assert!(!monitor.allows_idle_path());
    let mut scene = Scene::at(1_700);
    scene.delivered = false;
    scene.shows(|cycle| monitor.note(cycle, true));
    assert!(!monitor.left_target);
    assert_eq!(
        (monitor.stood, monitor.side, monitor.length),
        (Some(1_700), -1, 700)
    );
    assert_eq!(monitor.begun_at, 1_700);
    // Not for as long as nothing was delivered.
    scene.now += ms(50);
    scene.shows(|cycle| monitor.note(cycle, true));
    scene.delivered = true;
    scene.shows(|cycle| monitor.note(cycle, true));
    scene.now += ms(1);
    scene.shows(|cycle| monitor.note(cycle, true));
    assert!(!monitor.allows_idle_path());
    scene.now += ms(1);
    scene.shows(|cycle| monitor.note(cycle, true));
    assert!(monitor.allows_idle_path() && !monitor.left_target);
    scene.shows(|cycle| monitor.note(cycle, true));
    assert!(monitor.left_target);
}

#[test]
fn bit_11_is_taken_in_high_and_low() {
    let mut monitor = changed(to(1_000), |monitor| monitor.unlimited = false);
    monitor.note_limit(Statusword::INTERNAL_LIMIT);
    assert_eq!((monitor.unlimited, monitor.limited), (false, true));
    monitor.note_limit(Statusword::empty());
    assert_eq!((monitor.unlimited, monitor.limited), (true, false));
    monitor.note_limit(Statusword::INTERNAL_LIMIT);
    assert_eq!((monitor.unlimited, monitor.limited), (true, true));
}

/// Bit 10 that rises while the axis goes on further than its window in a cycle may be wrong for a cycle.
#[test]
fn a_rise_of_bit_10_at_speed_is_passing() {
    for (position, passing) in [(110, false), (111, true)] {
        let mut monitor = changed(to(1_000), |monitor| {
            (monitor.before, monitor.rose, monitor.low) = (100, ms(1_000), ms(2_000));
        });
        let mut scene = Scene::at(position);
        scene.word = Statusword::TARGET_REACHED;
        scene.shows(|cycle| monitor.note(cycle, true));
        assert_eq!((monitor.passing, monitor.rose), (passing, NOW));
        // It rises once.
        scene.now += ms(1);
        scene.position += 11;
        scene.shows(|cycle| monitor.note(cycle, true));
        assert_eq!((monitor.passing, monitor.rose), (passing, NOW));
        assert_eq!(monitor.before, position + 11);
    }
}

/// A bit 10 that was high when the set-point became active has not risen since.
#[test]
fn a_bit_10_that_was_never_low_does_not_rise() {
    let mut monitor = to(1_000);
    let mut scene = Scene::at(500);
    scene.word = Statusword::TARGET_REACHED;
    scene.shows(|cycle| monitor.note(cycle, true));
    assert_eq!((monitor.passing, monitor.rose), (false, ms(1_000)));
}

#[test]
fn a_target_beyond_half_the_circle_shows_its_way_once_the_axis_is_nearer() {
    let mut monitor = to(i32::MAX);
    monitor.turn(-1, &Scene::at(0).bounds);
    let length = monitor.length;
    Scene::at(-2).shows(|cycle| monitor.note(cycle, true));
    assert_eq!((monitor.far, monitor.length), (true, length));
    Scene::at(5).shows(|cycle| monitor.note(cycle, true));
    assert_eq!((monitor.far, monitor.length), (false, i32::MAX as u32 - 5));
}

#[test]
fn an_axis_leaves_its_place_once_when_it_is_further_away_than_its_window() {
    for (position, left) in [(10, None), (-10, None), (11, Some(NOW)), (-11, Some(NOW))] {
        let mut scene = Scene::at(position);
        scene.word = Statusword::TARGET_REACHED;
        let mut monitor = to(1_000);
        scene.shows(|cycle| monitor.outcome(cycle));
        assert_eq!(monitor.left_place, left, "{position}");
        monitor.left_place = Some(ms(5));
        scene.shows(|cycle| monitor.outcome(cycle));
        assert_eq!(monitor.left_place, Some(ms(5)));
    }
    // Where it did not stand it has no place.
    let mut monitor = changed(to(1_000), |monitor| monitor.stood = None);
    let mut scene = Scene::at(500);
    scene.word = Statusword::TARGET_REACHED;
    scene.shows(|cycle| monitor.outcome(cycle));
    assert_eq!(monitor.left_place, None);
}

#[test]
fn one_behind_a_set_point_in_doubt_is_in_doubt() {
    for unproven in [false, true] {
        let mut monitor = to(1_000);
        monitor.comes_after_doubt(unproven);
        assert!(monitor.follows && monitor.after_unseen);
        assert_eq!(monitor.doubted, unproven);
    }
}

/// The axis has still to come to where the demand of the first is, and nothing shows where that is.
#[test]
fn what_is_left_of_a_way_whose_end_is_not_known_is_no_motion_of_the_next() {
    let doubted = |first: &SetPointMonitor, mut second: SetPointMonitor, by_room: bool| {
        Scene::at(6).shows(|cycle| second.takes_over(first, by_room, false, cycle));
        second.doubted
    };
    let nowhere = distance(40, base(0));
    assert!(doubted(&nowhere, to(1_000), true));
    assert!(!doubted(&nowhere, to(1_000), false));
    assert!(!doubted(&nowhere, distance(400, base(0)), true));
    assert!(!doubted(&to(40), to(1_000), true));
}

#[test]
fn an_axis_comes_nearer_and_is_nearest_where_it_arrived() {
    let mut monitor = to(1_000);
    for (position, approaching, arrived) in [
        (0, false, None),
        (-1, false, None),
        (0, true, None),
        (989, true, None),
        (990, true, Some(990)),
        (1_003, true, Some(1_003)),
        (1_004, true, Some(1_003)),
        (997, true, Some(997)),
        (996, true, Some(997)),
    ] {
        Scene::at(position).shows(|cycle| monitor.note(cycle, true));
        let seen = (monitor.approaching, monitor.arrived);
        assert_eq!(seen, (approaching, arrived), "{position}");
    }
}

#[test]
fn bit_10_has_its_time_from_when_the_axis_has_come_back_to_its_end() {
    let late = |remaining: u32, alone: bool| {
        let mut monitor = changed(to(1_000), |monitor| {
            monitor.remaining = remaining;
            for quarters in (0..=4).rev() {
                let at = NOW - BEGIN / 4 * quarters;
                monitor.unreached.update(at, true, BEGIN);
            }
        });
        Scene::at(1_000).shows(|cycle| monitor.note(cycle, alone));
        monitor.unreached.update(NOW, true, BEGIN)
    };
    assert!(late(10, true), "it was there already");
    assert!(!late(11, true) && !late(30, true));
    assert!(late(11, false), "with another behind it the rest decides");
}

/// One that was replaced too fast to stop at its end is there, and comes back.
#[test]
fn one_that_was_not_begun_at_rest_overshoots_and_comes_back() {
    let beyond = |from_rest, alone, arrived, position: i32| {
        let mut monitor = changed(to(1_000), |monitor| {
            (monitor.from_rest, monitor.arrived, monitor.before) = (from_rest, arrived, position);
        });
        Scene::at(position).shows(|cycle| monitor.note(cycle, alone));
        (monitor.seen_there, monitor.side)
    };
    assert_eq!(beyond(false, true, None, 1_011), (true, -1));
    assert_eq!(beyond(false, true, None, 989), (false, 1));
    assert_eq!(beyond(false, true, Some(1_000), 989), (true, 1));
    assert_eq!(beyond(true, true, None, 1_011), (false, 1));
    assert_eq!(beyond(false, false, None, 1_011), (false, 1));
}

#[test]
fn a_cycle_that_leads_further_than_the_window_may_have_led_to_the_end() {
    let near = |from: i32, position: i32| {
        let mut monitor = changed(to(1_000), |monitor| monitor.before = from);
        Scene::at(position).shows(|cycle| monitor.note(cycle, false));
        monitor.near
    };
    // A way of the window itself is seen where it ends.
    assert!(!near(979, 989) && near(980, 990));
    // A longer one may have led as far again, and back.
    for (way, remaining, is_near) in [
        (11, 21, true),
        (11, 22, false),
        (40, 50, true),
        (40, 51, false),
    ] {
        let position = 1_000 - remaining;
        assert_eq!(near(position - way, position), is_near, "{way} {remaining}");
    }
}

#[test]
fn what_was_not_seen_may_have_been_the_end_at_four_times_the_fastest() {
    // 300 counts to the end and 300 back, in three cycles.
    let seen = |blind, fastest| {
        let mut monitor = changed(to(1_000), |monitor| {
            (monitor.remaining, monitor.before, monitor.fastest) = (300, 700, fastest);
        });
        let mut scene = Scene::at(700);
        scene.blind = blind;
        scene.shows(|cycle| monitor.note(cycle, false));
        scene.shows(|cycle| monitor.end_seen(cycle))
    };
    assert_eq!(seen(2, 50), EndSeen::Unseen);
    assert_eq!(seen(2, 49), EndSeen::Elsewhere);
    assert_eq!(seen(14, 0), EndSeen::Unseen);
    assert_eq!(seen(13, 0), EndSeen::Elsewhere);
    assert_eq!(seen(0, 1_000), EndSeen::Elsewhere);
}

#[test]
fn an_axis_that_turns_crosses_its_end_where_it_is_near() {
    let crossed = |end: i32, from: i32, position: i32| {
        let mut scene = Scene::turning(from);
        let mut monitor = begun(&scene, Reference::Absolute, end, Some(end));
        monitor.way = scene.bounds.way(from, end);
        monitor.before = from;
        scene.position = position;
        scene.shows(|cycle| monitor.note(cycle, false));
        monitor.crossed
    };
    assert!(crossed(100, 60, 140));
    assert!(crossed(100, 140, 60));
    assert!(crossed(10, 3_590, 30), "around the turn");
    assert!(!crossed(100, 60, 80), "before it");
    assert!(!crossed(100, 60, 100), "at it");
    assert!(!crossed(100, 100, 140), "from it");
    // Less than a quarter of the turn to the end, on both sides.
    assert!(crossed(1_800, 1_800 - 899, 1_800 + 899));
    assert!(!crossed(1_800, 1_800 - 900, 1_800 + 50));
    assert!(!crossed(1_800, 1_800 - 50, 1_800 + 900));
    assert!(!crossed(1_800, 1_800 - 1_790, 3_590 + 5), "the far side");
    // Once crossed, it is.
    let mut monitor = changed(
        begun(&Scene::turning(0), Reference::Absolute, 100, Some(100)),
        |monitor| {
            monitor.crossed = true;
        },
    );
    Scene::turning(60).shows(|cycle| monitor.note(cycle, false));
    assert!(monitor.crossed);
}

/// What may have been where nothing was seen is of the one behind as well; what was seen is of the first.
#[test]
fn the_one_behind_may_have_been_at_its_end_meanwhile() {
    let noted = |blind, position: i32| {
        let first = changed(to(500), |monitor| monitor.before = 890);
        let mut next = to(1_000);
        let mut scene = Scene::at(position);
        scene.blind = blind;
        scene.shows(|cycle| next.note_behind(&first, cycle));
        (next.unseen, next.near, next.arrived)
    };
    // A hundred and ten to the end, and ten back from there.
    assert_eq!(noted(2, 990), (40, false, None));
    assert_eq!(noted(0, 990), (u32::MAX, false, None));
}

/// Where bit 11 may be high for a limit, only the position says that the axis is there.
#[test]
fn the_end_is_seen_by_the_way_where_no_limit_was_active_and_else_by_the_position() {
    let seen = |position: i32, valid, change: fn(&mut SetPointMonitor)| {
        let monitor = changed(to(1_000), change);
        let mut scene = Scene::at(position);
        scene.bit_11_is_valid = valid;
        scene.shows(|cycle| monitor.end_seen(cycle))
    };
    let limited =
        |monitor: &mut SetPointMonitor| (monitor.unlimited, monitor.limited) = (false, true);
    let unknown =
        |monitor: &mut SetPointMonitor| (monitor.unlimited, monitor.limited) = (false, false);
    for (position, valid, change, expected) in [
        (
            1_500,
            true,
            (|_| ()) as fn(&mut SetPointMonitor),
            EndSeen::There,
        ),
        (500, true, |_| (), EndSeen::Elsewhere),
        (1_500, true, limited, EndSeen::Elsewhere),
        (1_010, true, limited, EndSeen::There),
        (1_011, true, limited, EndSeen::Elsewhere),
        (1_500, false, limited, EndSeen::There),
        (1_500, true, unknown, EndSeen::Unseen),
        (500, false, unknown, EndSeen::Elsewhere),
    ] {
        assert_eq!(
            seen(position, valid, change),
            expected,
            "{position} {valid}"
        );
    }
    let nowhere = distance(400, base(0));
    let seen = Scene::at(0).shows(|cycle| nowhere.end_seen(cycle));
    assert_eq!(seen, EndSeen::There, "where it ends is not known");
}

#[test]
fn each_of_four_signs_shows_that_the_axis_came_to_the_end() {
    let over = |change: fn(&mut SetPointMonitor)| {
        let monitor = changed(to(1_000), change);
        Scene::at(500).shows(|cycle| monitor.may_be_over(cycle))
    };
    assert!(!over(|_| ()));
    assert!(over(|monitor| monitor.near = true));
    assert!(over(|monitor| monitor.arrived = Some(1_000)));
    assert!(over(|monitor| monitor.seen_there = true));
    assert!(over(|monitor| monitor.side = -1));
    assert!(over(|monitor| monitor.end = None));
}

#[test]
fn a_distance_without_an_end_is_seen_at_its_end_once_the_axis_has_left() {
    let seen = |way, position: i32| {
        let monitor = distance(way, base(0));
        Scene::at(position).shows(|cycle| monitor.is_seen_at_end(cycle))
    };
    assert!(!seen(21, 10) && !seen(-21, -10));
    assert!(seen(21, 11));
    assert!(seen(20, 10) && seen(-20, 0), "no way to speak of");
    let known = to(1_000);
    assert!(!Scene::at(500).shows(|cycle| known.is_seen_at_end(cycle)));
    assert!(Scene::at(1_001).shows(|cycle| known.is_seen_at_end(cycle)));
    // One that was in motion has left where it was then.
    let moving = |begun_at| {
        changed(distance(400, base(0)), |monitor| {
            (monitor.stood, monitor.begun_at) = (None, begun_at);
        })
    };
    assert!(Scene::at(0).shows(|cycle| moving(11).is_seen_at_end(cycle)));
    assert!(!Scene::at(0).shows(|cycle| moving(10).is_seen_at_end(cycle)));
}

#[test]
fn the_position_shows_a_stop_or_a_passing_where_it_is_beyond_doubt() {
    let shows = |change: fn(&mut SetPointMonitor)| {
        let monitor = changed(to(1_000), change);
        (monitor.shows_its_stop(), monitor.shows_its_passing())
    };
    assert_eq!(shows(|_| ()), (true, true));
    assert_eq!(shows(|monitor| monitor.from_rest = false), (false, false));
    assert_eq!(
        shows(|monitor| (monitor.from_rest, monitor.approaching) = (false, true)),
        (false, true)
    );
    let doubts: [fn(&mut SetPointMonitor); 5] = [
        |monitor| monitor.end = None,
        |monitor| monitor.turns = true,
        |monitor| monitor.far = true,
        |monitor| monitor.short = true,
        |monitor| monitor.unlimited = false,
    ];
    for doubt in doubts {
        assert_eq!(shows(doubt), (false, false));
    }
}

/// A set-point that ends at 0, reached, and one behind it to 1000 whose way an axis has gone to here.
fn left_behind(
    scene: &Scene,
    goal: i32,
    change: impl FnOnce(&mut SetPointMonitor),
) -> (bool, SetPointMonitor) {
    let mut first = changed(to(0), |monitor| {
        monitor.arrived = Some(0);
        (monitor.since, monitor.length) = (ms(1_000), 1_000);
        monitor.short = false;
    });
    change(&mut first);
    let next = to(goal);
    let left = scene.shows(|cycle| first.is_left_behind(&next, cycle));
    (left, first)
}

#[test]
fn a_set_point_is_left_behind_half_way_to_the_next_end() {
    let left = |position: i32, goal: i32, change: fn(&mut SetPointMonitor)| {
        left_behind(&Scene::at(position), goal, change).0
    };
    assert!(left(500, 1_000, |_| ()) && !left(499, 1_000, |_| ()));
    assert!(left(-500, -1_000, |_| ()) && !left(-499, -1_000, |_| ()));
    // A way of three windows shows nothing.
    let short = |monitor: &mut SetPointMonitor| monitor.length = 0;
    assert!(left(15, 31, short) && !left(15, 30, short));
    assert!(left(-15, -31, short) && !left(-15, -30, short));
    // Half as far as its own way was.
    assert!(left(500, 1_000, |monitor| monitor.length = 1_001));
    assert!(!left(500, 1_000, |monitor| monitor.length = 1_002));
    // One that swung when it set off, one that went further before, one that was as far on the other side.
    assert!(!left(500, 1_000, |monitor| monitor.swings = true));
    assert!(left(500, 1_000, |monitor| monitor.farthest = 500));
    assert!(!left(500, 1_000, |monitor| monitor.farthest = 501));
    assert!(left(500, 1_000, |monitor| monitor.astray = 499));
    assert!(!left(500, 1_000, |monitor| monitor.astray = 500));
    // It was not there.
    assert!(!left(500, 1_000, |monitor| monitor.arrived = None));
    assert!(!left(500, 1_000, |monitor| (
        monitor.arrived,
        monitor.side
    ) = (None, -1)));
    assert!(left(500, 1_000, |monitor| (
        monitor.arrived,
        monitor.side
    ) = (None, 1)));
    // One that may come back to its end is not over beyond it.
    assert!(!left(500, 1_000, |monitor| (
        monitor.overshoots,
        monitor.side
    ) = (true, 1)));
    assert!(left(500, 1_000, |monitor| (
        monitor.overshoots,
        monitor.side
    ) = (true, 0)));
    for mode in [BufferMode::Buffered, BufferMode::Blending] {
        let passing = |monitor: &mut SetPointMonitor| {
            (monitor.ends_in_motion, monitor.side) = (true, 1);
        };
        let (_, mut first) = left_behind(&Scene::at(0), 1_000, passing);
        let next = changed(to(1_000), |monitor| monitor.buffer_mode = mode);
        let left = Scene::at(500).shows(|cycle| first.is_left_behind(&next, cycle));
        assert_eq!(left, mode == BufferMode::Blending);
    }
    for doubt in [
        (|monitor| monitor.short = true) as fn(&mut SetPointMonitor),
        |monitor| monitor.turns = true,
        |monitor| monitor.far = true,
        |monitor| monitor.end = None,
    ] {
        assert!(!left(500, 1_000, doubt));
    }
}

#[test]
fn one_that_has_stood_at_its_end_is_left_three_windows_from_there() {
    let left = |position: i32, goal: i32| {
        let rested =
            |monitor: &mut SetPointMonitor| (monitor.rested, monitor.length) = (true, 4_000);
        left_behind(&Scene::at(position), goal, rested).0
    };
    assert!(left(30, 1_000) && !left(29, 1_000));
    assert!(left(25, 50) && !left(24, 50), "or half of the way");
}

/// An input of the drive may have stopped it there before it comes to either end.
#[test]
fn one_that_stands_beyond_both_ends_is_not_left_behind() {
    let left = |position, goal| left_behind(&Scene::at(position), goal, |_| ()).0;
    assert!(left(1_010, 1_000) && !left(1_011, 1_000));
    assert!(left(-1_010, -1_000) && !left(-1_011, -1_000));
}

#[test]
fn one_that_stays_away_for_the_settle_time_is_left_behind_half_way() {
    let left = |position: i32, since: Duration, cycles| {
        left_behind(&Scene::at(position), 1_000, |monitor| {
            monitor.swings = true;
            monitor.away = Some((since, cycles));
        })
    };
    assert!(left(500, NOW - SETTLE, 2).0);
    assert!(!left(500, NOW - SETTLE + ms(1), 2).0);
    assert!(!left(500, NOW - SETTLE, 1).0);
    assert!(!left(499, NOW - SETTLE, 2).0);
    let stands = left_behind(&Scene::rests(500, ms(150)), 1_000, |monitor| {
        monitor.swings = true;
        monitor.away = Some((NOW - SETTLE, 2));
    });
    assert!(!stands.0, "it may have been stopped on its way back");
    assert_eq!(left(11, NOW - SETTLE, 2).1.away, Some((NOW - SETTLE, 3)));
    assert_eq!(left(10, NOW - SETTLE, 2).1.away, None);
}

#[test]
fn at_its_end_an_axis_stands_or_swings_to_the_other_side() {
    let at = |scene: &Scene, change: fn(&mut SetPointMonitor)| {
        let (left, first) = left_behind(scene, 1_000, change);
        assert!(!left);
        first
    };
    let stood = |position: i32, time| at(&Scene::rests(position, time), |_| ()).rested;
    assert!(stood(10, ms(150)) && stood(-10, ms(150)));
    assert!(!stood(-11, ms(150)));
    assert!(!stood(0, ms(50)));
    assert!(at(&Scene::at(0), |monitor| monitor.rested = true).rested);
    assert_eq!(at(&Scene::at(-40), |_| ()).astray, 40);
    assert_eq!(
        at(&Scene::at(-40), |monitor| monitor.astray = 50).astray,
        50
    );
    assert_eq!(
        at(&Scene::at(-40), |monitor| monitor.arrived = None).astray,
        0
    );
    assert!(at(&Scene::at(0), |_| ()).seen_there);
    assert!(!at(&Scene::at(0), |monitor| monitor.arrived = None).seen_there);
}

/// What an axis at rest at 2000 shows of a set-point to 1000, with one to `next` behind it.
fn at_rest(next: Option<i32>, change: impl FnOnce(&mut SetPointMonitor)) -> Option<Rest> {
    let mut first = changed(to(1_000), |monitor| monitor.side = 0);
    change(&mut first);
    let next = changed(to(0), |monitor| monitor.end = next);
    Scene::rests(2_000, ms(200)).shows(|cycle| first.rests_with(&next, cycle))
}

#[test]
fn two_set_points_are_over_with_an_axis_at_rest_at_the_end_of_the_second() {
    let rests = |change: fn(&mut SetPointMonitor)| at_rest(Some(2_010), change);
    assert_eq!(
        rests(|monitor| monitor.stood = None),
        None,
        "nothing has begun"
    );
    let over = Some(Rest::BothOver);
    assert_eq!(
        rests(|monitor| (monitor.stood, monitor.left_target) = (None, true)),
        over
    );
    assert_eq!(
        rests(|monitor| {
            (monitor.stood, monitor.left_target, monitor.after_unseen) = (None, true, true);
        }),
        None
    );
    // It has moved, and come to rest away from where it stood.
    let away = Some(ms(2_000));
    assert_eq!(
        at_rest(Some(2_000), |monitor| (monitor.stood, monitor.left_place) =
            (Some(0), away)),
        over
    );
    assert_eq!(
        at_rest(Some(2_000), |monitor| (monitor.stood, monitor.left_place) =
            (Some(1_989), away)),
        over
    );
    assert_eq!(
        at_rest(Some(2_000), |monitor| (monitor.stood, monitor.left_place) =
            (Some(1_990), away)),
        None
    );
    assert_eq!(
        at_rest(Some(2_000), |monitor| monitor.stood = Some(0)),
        None,
        "just now"
    );
    assert_eq!(
        at_rest(Some(2_000), |monitor| {
            (monitor.stood, monitor.left_place, monitor.doubted) = (Some(0), away, true);
        }),
        None
    );
    // It was at its end.
    let there = Some(1_000);
    assert_eq!(
        rests(|monitor| (monitor.stood, monitor.arrived) = (None, Some(1_000))),
        over
    );
    for (by_room, short, stood, expected) in [
        (true, true, Some(2_000), None),
        (true, false, None, None),
        (true, false, Some(2_000), over),
        (false, true, None, over),
    ] {
        let rest = at_rest(Some(2_010), |monitor| {
            (monitor.arrived, monitor.by_room, monitor.short) = (there, by_room, short);
            monitor.stood = stood;
        });
        assert_eq!(rest, expected, "{by_room} {short} {stood:?}");
    }
    assert_eq!(
        rests(|monitor| (monitor.stood, monitor.end) = (None, None)),
        None
    );
    // It had no way to go.
    assert_eq!(
        rests(|monitor| (monitor.stood, monitor.remaining) = (None, 10)),
        over
    );
    assert_eq!(
        rests(|monitor| (monitor.stood, monitor.remaining) = (None, 11)),
        None
    );
}

#[test]
fn the_second_may_end_where_a_distance_leads_once_the_first_is_proven() {
    let rest = |proven: bool, base_at: i32| {
        let mut first = changed(to(1_000), |monitor| {
            (monitor.stood, monitor.remaining) = (None, if proven { 5_000 } else { 0 });
            (monitor.left_target, monitor.side) = (proven, 0);
        });
        let next = distance(400, base(base_at));
        Scene::rests(2_000, ms(200)).shows(|cycle| first.rests_with(&next, cycle))
    };
    assert_eq!(rest(true, 1_600), Some(Rest::BothOver));
    assert_eq!(rest(true, 1_000), None);
    assert_eq!(rest(false, 1_600), None);
}

#[test]
fn an_axis_at_rest_elsewhere_is_given_the_time_to_begin() {
    let rests = |resting: Duration, change: fn(&mut SetPointMonitor)| {
        at_rest(Some(5_000), |monitor| {
            monitor.stood = None;
            monitor.resting = Some(resting);
            change(monitor);
        })
    };
    let late = NOW - BEGIN;
    let next = Some(Rest::NextNotBegun);
    assert_eq!(rests(late, |monitor| monitor.left_target = true), next);
    assert_eq!(
        rests(late + ms(1), |monitor| monitor.left_target = true),
        None
    );
    assert_eq!(rests(late, |_| ()), Some(Rest::NoneBegun));
    // Of a distance without an end: where it may end, it has.
    let lost = |monitor: &mut SetPointMonitor| {
        *monitor = changed(distance(400, base(0)), |monitor| {
            (monitor.left_target, monitor.stood) = (true, None);
            monitor.resting = Some(NOW - BEGIN);
        });
    };
    assert_eq!(rests(late, lost), Some(Rest::NoneBegun));
    let led_here = |monitor: &mut SetPointMonitor| {
        *monitor = changed(distance(400, base(1_600)), |monitor| {
            (monitor.left_target, monitor.stood) = (true, None);
            monitor.resting = Some(NOW - BEGIN);
        });
    };
    assert_eq!(rests(late, led_here), next);
    // Still in motion, or with bit 10 low: from the beginning.
    let mut first = changed(to(1_000), |monitor| monitor.resting = Some(late));
    let behind = to(5_000);
    let moving = Scene::rests(2_000, ms(50));
    assert_eq!(moving.shows(|cycle| first.rests_with(&behind, cycle)), None);
    assert_eq!(first.resting, None);
    first.resting = Some(late);
    let mut low = Scene::rests(2_000, ms(200));
    low.word = Statusword::empty();
    assert_eq!(low.shows(|cycle| first.rests_with(&behind, cycle)), None);
    assert_eq!(first.resting, None);
    // One that lingers is at rest, too.
    first.resting = Some(late);
    first.lingering.rests = true;
    let rest = moving.shows(|cycle| first.rests_with(&behind, cycle));
    assert!(rest.is_some(), "{rest:?}");
}

#[test]
fn bit_10_on_an_axis_that_has_stood_since_it_was_low_is_a_rest() {
    let rests = |time: Duration, change: fn(&mut Scene, &mut SetPointMonitor)| {
        let mut scene = Scene::rests(500, time);
        let mut monitor = to(1_000);
        change(&mut scene, &mut monitor);
        scene.shows(|cycle| monitor.is_at_rest(cycle))
    };
    assert!(rests(ms(100), |_, _| ()));
    assert!(!rests(ms(99), |_, _| ()));
    assert!(!rests(ms(200), |scene, _| scene.word = Statusword::empty()));
    assert!(!rests(ms(200), |_, monitor| monitor.low = NOW - ms(99)));
    assert!(!rests(ms(200), |_, monitor| monitor.since = NOW - ms(99)));
    assert!(rests(ms(50), |_, monitor| monitor.lingering.rests = true));
}

#[test]
fn how_one_ended_that_another_has_followed() {
    let ended = |scene: &Scene, monitor: &SetPointMonitor, next| {
        scene.shows(|cycle| monitor.ended_into(next, cycle))
    };
    let scene = Scene::at(1_500);
    let position = 1_500;
    let passed = Ok(Completion::Passed { position });
    let first = to(1_000);
    assert_eq!(ended(&scene, &first, BufferMode::Blending), passed);
    let reached = Ok(Completion::Reached { position });
    assert_eq!(ended(&scene, &first, BufferMode::Buffered), reached);
    let arrived = changed(to(1_000), |monitor| monitor.arrived = Some(1_003));
    let nearest = Ok(Completion::Reached { position: 1_003 });
    assert_eq!(ended(&scene, &arrived, BufferMode::Buffered), nearest);
    let missed = Failure::MissedTarget {
        target: 1_000,
        actual: 500,
    };
    assert_eq!(
        ended(&Scene::at(500), &first, BufferMode::Buffered),
        Err(missed)
    );
    let blind = changed(to(1_000), |monitor| monitor.unseen = 0);
    let unseen = Failure::Unseen {
        target: 1_000,
        actual: 500,
    };
    assert_eq!(
        ended(&Scene::at(500), &blind, BufferMode::Buffered),
        Err(unseen)
    );
    let nowhere = distance(400, base(0));
    let unknown = Failure::EndNotKnown { actual: 10 };
    assert_eq!(
        ended(&Scene::at(10), &nowhere, BufferMode::Buffered),
        Err(unknown)
    );
    let gone = Ok(Completion::Reached { position: 11 });
    assert_eq!(ended(&Scene::at(11), &nowhere, BufferMode::Buffered), gone);
}

/// What an axis that shows this says of the last set-point.
fn shown(scene: &Scene, mut monitor: SetPointMonitor) -> Option<Result<Completion, Failure>> {
    scene.shows(|cycle| monitor.outcome(cycle))
}

fn reached(position: i32) -> Option<Result<Completion, Failure>> {
    Some(Ok(Completion::Reached { position }))
}

#[test]
fn bit_10_that_was_low_is_the_end_within_the_window() {
    let left = |position: i32, change: fn(&mut SetPointMonitor)| {
        let mut scene = Scene::at(position);
        scene.word = Statusword::TARGET_REACHED;
        let monitor = changed(to(1_000), |monitor| monitor.left_target = true);
        shown(&scene, changed(monitor, change))
    };
    assert_eq!(left(1_010, |_| ()), reached(1_010));
    assert_eq!(left(1_011, |_| ()), None);
    assert_eq!(left(990, |_| ()), reached(990));
    assert_eq!(left(1_010, |monitor| monitor.left_target = false), None);
    // A bit 10 that rose at speed may be wrong until the drive has shown another.
    let passing =
        |monitor: &mut SetPointMonitor| (monitor.passing, monitor.rose) = (true, NOW - ms(1));
    assert_eq!(left(1_010, passing), None);
    let over =
        |monitor: &mut SetPointMonitor| (monitor.passing, monitor.rose) = (true, NOW - ms(2));
    assert_eq!(left(1_010, over), reached(1_010));
    let slow =
        |monitor: &mut SetPointMonitor| (monitor.passing, monitor.rose) = (false, NOW - ms(1));
    assert_eq!(left(1_010, slow), reached(1_010));
}

#[test]
fn a_bit_10_where_the_way_may_lead_round_is_believed_once_it_has_stayed() {
    for (rose, ends) in [(NOW - ms(1), None), (NOW - ms(2), reached(1_010))] {
        let mut scene = Scene::at(1_010);
        scene.word = Statusword::TARGET_REACHED;
        let monitor = changed(to(1_000), |monitor| {
            (monitor.left_target, monitor.may_lead_round) = (true, true);
            monitor.rose = rose;
        });
        assert_eq!(shown(&scene, monitor), ends);
    }
}

/// A set-point to 569 was replaced before the axis set off, by a distance that ends within the window of where it stands. Or a distance of
/// a whole turn.
#[test]
fn a_distance_that_leads_round_is_not_over_where_the_axis_stood_before_it() {
    let shows = |distance: i32, end: i32, positions: &[i32]| {
        let mut scene = Scene::turning(0);
        scene.word = Statusword::TARGET_REACHED;
        scene.traits.relative_base = RelativeBase::PreviousTarget;
        let mut monitor = begun(&scene, Reference::Relative, distance, Some(end));
        (1..).zip(positions).find_map(|(at, &position)| {
            (scene.now, scene.position) = (ms(1_000 + at), position);
            scene
                .standstill
                .update(scene.now, position, None, &scene.bounds);
            scene.shows(|cycle| {
                monitor.note(cycle, true);
                monitor.outcome(cycle)
            })
        })
    };
    let stands = [0; 500];
    assert_eq!(shows(3_035, 4, &stands), None);
    assert_eq!(shows(3_600, 0, &stands), None);
    assert_eq!(shows(-7_200, 0, &stands), None);
    assert_eq!(shows(8, 8, &stands), reached(0));
    let mut goes_round = [0; 500];
    goes_round[1..6].copy_from_slice(&[11, 900, 1_800, 2_700, 3_591]);
    assert_eq!(shows(3_600, 0, &goes_round), reached(0));
    // Behind another, as long as the axis is at the end of that.
    let before = begun(&Scene::turning(0), Reference::Absolute, 550, Some(550));
    for (position, leads_round) in [(560, true), (3_450, false)] {
        Scene::turning(position).shows(|cycle| {
            let mut next = distance(-700, base(0));
            (next.turns, next.end) = (true, Some(3_450));
            next.takes_over(&before, true, false, cycle);
            assert_eq!(next.leads_round, leads_round);
        });
    }
}

#[test]
fn a_way_may_lead_round_where_its_end_was_within_the_lag_of_an_axis_in_motion() {
    // 10 counts in a millisecond: behind by up to 400.
    let round = |scene: Scene, stands: bool, end: i32| {
        let command = MoveCommand {
            reference: Reference::Absolute,
            target: end,
            set_point: SetPoint::new(),
            gated: false,
        };
        let raised = Raised {
            stands,
            begin: 0,
            since: NOW - ms(1),
            ..raised(1, command, Some(end))
        };
        scene.shows(|cycle| SetPointMonitor::new(&raised, true, cycle).may_lead_round)
    };
    assert!(round(Scene::turning(10), false, 400));
    assert!(!round(Scene::turning(10), false, 401));
    assert!(!round(Scene::turning(10), true, 400));
    assert!(!round(Scene::at(10), false, 400));
}

#[test]
fn with_bit_10_low_nothing_has_ended_and_one_in_doubt_waits_anew() {
    for (doubted, resting) in [(true, None), (false, Some(ms(5)))] {
        let mut monitor = changed(to(1_000), |monitor| {
            (monitor.doubted, monitor.resting) = (doubted, Some(ms(5)));
        });
        let outcome = Scene::at(1_000).shows(|cycle| monitor.outcome(cycle));
        assert_eq!((outcome, monitor.resting), (None, resting));
    }
}

#[test]
fn a_distance_ends_where_it_may_lead_unless_one_before_it_is_in_doubt() {
    let left = |change: fn(&mut SetPointMonitor)| {
        let mut scene = Scene::at(400);
        scene.word = Statusword::TARGET_REACHED;
        let monitor = changed(distance(400, base(0)), |monitor| monitor.left_target = true);
        shown(&scene, changed(monitor, change))
    };
    assert_eq!(left(|_| ()), reached(400));
    assert_eq!(left(|monitor| monitor.doubted = true), None);
    assert_eq!(left(|monitor| monitor.bases.position = 100), None);
    assert_eq!(left(|monitor| monitor.left_target = false), None);
    // One whose end is reckoned from a base that may be beside it.
    assert_eq!(
        left(|monitor| (monitor.end, monitor.doubted) = (Some(500), true)),
        reached(400)
    );
    assert_eq!(
        left(|monitor| (monitor.end, monitor.is_loose) = (Some(500), false)),
        None
    );
}

#[test]
fn an_axis_at_rest_at_the_end_is_there_without_a_word_of_bit_10() {
    let at = |position: i32, time| shown(&Scene::rests(position, time), to(1_000));
    assert_eq!(at(1_010, ms(100)), reached(1_010));
    assert_eq!(at(1_010, ms(99)), None);
    // A distance that may count from elsewhere may have its way still to go.
    let loose = |base_at: i32| {
        let monitor = changed(distance(400, base(base_at)), |monitor| {
            (monitor.end, monitor.goal) = (Some(400), Some(400));
            monitor.since = NOW - ms(500);
        });
        shown(&Scene::rests(405, ms(100)), monitor)
    };
    assert_eq!(loose(0), reached(405));
    assert_eq!(loose(-6), None);
}

#[test]
fn a_distance_that_is_no_way_ends_where_the_last_one_ended_well() {
    let at = |way: i32, change: fn(&mut SetPointMonitor)| {
        let monitor = changed(distance(way, base(500)), change);
        shown(&Scene::rests(0, ms(100)), monitor)
    };
    assert_eq!(at(10, |_| ()), reached(0));
    assert_eq!(at(-10, |_| ()), reached(0));
    assert_ne!(at(11, |_| ()), reached(0));
    assert_ne!(at(10, |monitor| monitor.at_base = false), reached(0));
    assert_ne!(at(10, |monitor| monitor.doubted = true), reached(0));
}

#[test]
fn an_axis_that_has_come_to_rest_elsewhere_has_missed_its_target() {
    let elsewhere = |position: i32, change: fn(&mut SetPointMonitor)| {
        let monitor = changed(to(1_000), |monitor| {
            monitor.since = NOW - ms(500);
            (monitor.stood, monitor.left_place) = (Some(0), Some(NOW - ms(150)));
        });
        shown(&Scene::rests(position, ms(200)), changed(monitor, change))
    };
    let missed = |actual: i32| {
        Some(Err(Failure::MissedTarget {
            target: 1_000,
            actual,
        }))
    };
    assert_eq!(elsewhere(11, |_| ()), missed(11));
    assert_eq!(elsewhere(10, |_| ()), None);
    assert_eq!(elsewhere(12, |_| ()), missed(12));
    // A load has moved it away from its end: the drive may begin yet.
    assert_eq!(elsewhere(-11, |_| ()), None);
    assert_eq!(
        elsewhere(11, |monitor| monitor.left_place = Some(NOW - ms(50))),
        None
    );
    assert_eq!(
        elsewhere(0, |monitor| monitor.left_target = true),
        missed(0)
    );
    assert_eq!(
        elsewhere(0, |monitor| (monitor.left_target, monitor.follows) =
            (true, true)),
        None
    );
    // One before it in doubt may have moved the axis: this one has its time first.
    assert_eq!(elsewhere(11, |monitor| monitor.doubted = true), None);
    let late = |monitor: &mut SetPointMonitor| {
        (monitor.doubted, monitor.resting) = (true, Some(NOW - BEGIN));
    };
    assert_eq!(elsewhere(11, late), missed(11));
    let not_late = |monitor: &mut SetPointMonitor| {
        (monitor.doubted, monitor.resting) = (true, Some(NOW - BEGIN + ms(1)));
    };
    assert_eq!(elsewhere(11, not_late), None);
    // Wherever it led: a distance without an end.
    assert_eq!(
        elsewhere(500, |monitor| (monitor.end, monitor.distance) =
            (None, Some(400))),
        Some(Err(Failure::EndNotKnown { actual: 500 }))
    );
    assert_eq!(
        elsewhere(400, |monitor| {
            let bases = base(0);
            *monitor = SetPointMonitor {
                stood: Some(0),
                left_place: Some(ms(2_000)),
                ..distance(400, bases)
            };
        }),
        reached(400)
    );
}

#[test]
fn an_axis_that_stays_for_the_time_to_begin_has_not_begun() {
    let stays = |since: Duration, change: fn(&mut SetPointMonitor)| {
        let monitor = changed(to(1_000), |monitor| monitor.since = since);
        shown(&Scene::rests(0, ms(2_000)), changed(monitor, change))
    };
    let not_begun = Some(Err(Failure::NotBegun { actual: 0 }));
    assert_eq!(stays(NOW - BEGIN, |_| ()), not_begun);
    assert_eq!(stays(NOW - BEGIN + ms(1), |_| ()), None);
    // So long after bit 10 was low, it was low for this one.
    let beside = |monitor: &mut SetPointMonitor| {
        monitor.begins_beside = true;
        (monitor.left_target, monitor.follows) = (true, true);
    };
    let missed = Failure::MissedTarget {
        target: 1_000,
        actual: 0,
    };
    assert_eq!(stays(NOW - BEGIN, beside), Some(Err(missed)));
    assert_eq!(
        stays(NOW - BEGIN, |monitor| monitor.begins_beside = true),
        not_begun
    );
    assert_eq!(
        stays(NOW - BEGIN, |monitor| (
            monitor.left_target,
            monitor.follows
        ) = (true, true)),
        not_begun
    );
}

/// An axis that never comes to rest within its window has to have gone further than it swings.
#[test]
fn an_axis_that_lingers_has_moved_when_it_is_further_away_than_it_swings() {
    let lingers = |position: i32, change: fn(&mut SetPointMonitor)| {
        let mut monitor = changed(to(1_000), |monitor| {
            monitor.since = NOW - ms(500);
            monitor.lingering.rests = true;
            monitor.lingering.before = Some((0, 30));
            monitor.lingering.span.update(NOW, true, BEGIN);
            monitor.lingering.bounds = Some((0, 30));
        });
        change(&mut monitor);
        shown(&Scene::rests(position, ms(50)), monitor)
    };
    let missed = Some(Err(Failure::MissedTarget {
        target: 1_000,
        actual: 41,
    }));
    assert_eq!(lingers(41, |_| ()), missed);
    assert_eq!(lingers(40, |_| ()), None);
    assert_eq!(lingers(41, |monitor| monitor.lingering.rests = false), None);
}

#[test]
fn a_distance_may_end_within_its_lag_behind_one_that_ended_beside() {
    let bounds = Scene::at(0).bounds;
    let behind = changed(distance(400, base(5_000)), |monitor| {
        monitor.goal = Some(1_000);
    });
    assert!(behind.may_end_at(1_100, &bounds) && !behind.may_end_at(1_101, &bounds));
    assert!(behind.may_end_at(900, &bounds) && !behind.may_end_at(899, &bounds));
    let of_base = changed(behind, |monitor| monitor.end = Some(1_000));
    assert!(!of_base.may_end_at(1_000, &bounds) && of_base.may_end_at(5_400, &bounds));
    let known = changed(behind, |monitor| monitor.is_loose = false);
    assert!(!known.may_end_at(1_000, &bounds));
    assert!(!to(1_000).may_end_at(1_000, &bounds), "a position");
}

#[test]
fn a_miss_says_what_is_known_of_the_end() {
    let missed = |change: fn(&mut SetPointMonitor)| changed(to(1_000), change).missed(1_000, 7);
    let (target, actual) = (1_000, 7);
    let unknown = Failure::EndNotKnown { actual };
    let miss = Failure::MissedTarget { target, actual };
    assert_eq!(missed(|_| ()), miss);
    assert_eq!(
        missed(|monitor| monitor.confirmed = false),
        Failure::Unconfirmed { target, actual }
    );
    assert_eq!(missed(|monitor| monitor.is_vague = true), unknown);
    assert_eq!(
        missed(|monitor| (monitor.is_loose, monitor.stood_before) = (true, false)),
        unknown
    );
    assert_eq!(
        missed(|monitor| (monitor.is_loose, monitor.stood_before) = (true, true)),
        miss
    );
    assert_eq!(missed(|monitor| monitor.stood_before = false), miss);
}

#[test]
fn a_way_of_three_windows_is_short_and_one_of_half_the_circle_far() {
    let turned = |end: i32, change: fn(&mut SetPointMonitor)| {
        let mut monitor = changed(to(end), change);
        monitor.turn(0, &Scene::at(0).bounds);
        (monitor.short, monitor.far)
    };
    assert_eq!(turned(30, |_| ()), (true, false));
    assert_eq!(turned(-31, |_| ()), (false, false));
    let mut monitor = to(i32::MAX);
    let bounds = Scene::at(0).bounds;
    for (from, far) in [(0, false), (-1, true), (1, false), (i32::MIN, true)] {
        monitor.turn(from, &bounds);
        assert_eq!(monitor.far, far, "{from}");
    }
    let far = |change: fn(&mut SetPointMonitor)| changed(to(i32::MAX), change).is_far(-1, &bounds);
    assert!(far(|_| ()));
    assert!(!far(|monitor| monitor.absolute = false));
    assert!(!far(|monitor| monitor.turns = true));
    assert!(!far(|monitor| monitor.end = None));
}

#[test]
fn an_axis_has_passed_its_end_on_the_side_that_it_did_not_come_from() {
    for (side, position, passed) in [
        (1, 1_001, true),
        (1, 1_000, false),
        (1, 999, false),
        (-1, 999, true),
        (-1, 1_000, false),
        (-1, 1_001, false),
        (0, 1_000, false),
        (0, 1_001, false),
    ] {
        let mut monitor = changed(to(1_000), |monitor| monitor.side = side);
        assert_eq!(monitor.passed(position), passed, "{side} {position}");
        monitor.far = true;
        assert!(!monitor.passed(position));
        (monitor.turns, monitor.crossed) = (true, false);
        assert!(!monitor.passed(position));
        monitor.crossed = true;
        assert!(monitor.passed(position));
    }
}

/// A modulo axis is beyond every place of its turn, and one that dithers is on both sides of a place near it: that it has gone through its
/// end shows only on the way there.
#[test]
fn an_end_in_motion_that_may_have_been_passed_unacknowledged_is_not_missed() {
    let missed = |scene: Scene, target: i32, passes: bool| {
        let mut command = command(Reference::Absolute, target);
        command.set_point.parameters.end_velocity = passes.then_some(500);
        let raised = raised(1, command, Some(target));
        let monitor = scene.shows(|cycle| SetPointMonitor::new(&raised, true, cycle));
        monitor.missed(target, 1_500)
            != Failure::Unseen {
                target,
                actual: 1_500,
            }
    };
    assert!(!missed(Scene::turning(11), 1_000, true));
    assert!(!missed(Scene::at(11), 30, true));
    // It has not set off, it stops at its end, or it is an axis of which a place beyond shows enough.
    assert!(missed(Scene::turning(10), 1_000, true));
    assert!(missed(Scene::turning(11), 1_000, false));
    assert!(missed(Scene::at(11), 31, true));
    assert!(missed(Scene::at(11), 30, false));
}

/// The drive may hold the one before it still, which has led the axis there.
#[test]
fn one_after_a_doubt_has_not_led_the_axis_away_from_its_end() {
    let rest = |stood: i32, after_unseen: bool| {
        at_rest(Some(2_000), |monitor| {
            (monitor.stood, monitor.left_place) = (Some(stood), Some(ms(2_000)));
            monitor.after_unseen = after_unseen;
        })
    };
    assert_eq!(rest(1_900, true), None);
    assert_eq!(rest(2_100, true), Some(Rest::BothOver));
    assert_eq!(rest(1_900, false), Some(Rest::BothOver));
}

/// What is older than what it is compared with may be forgotten; what is not may not.
#[test]
fn a_rise_at_speed_is_remembered_for_the_settle_time() {
    for (rose, passing) in [(NOW - SETTLE, false), (NOW - SETTLE + ms(1), true)] {
        let mut monitor = changed(to(1_000), |monitor| {
            (monitor.passing, monitor.rose) = (true, rose);
        });
        monitor.canonicalize(NOW, BEGIN, SETTLE);
        assert_eq!(monitor.passing, passing);
        let mut slow = changed(to(1_000), |monitor| monitor.rose = rose);
        slow.canonicalize(NOW, BEGIN, SETTLE);
        assert!(!slow.passing);
    }
}

/// Bit 10 was low when it was sent, and is high in each cycle since: its way took none.
#[test]
fn an_end_in_motion_that_was_passed_at_once_is_reached_when_it_would_have_begun() {
    let after = |time: Duration| {
        let mut scene = Scene::at(1_500);
        scene.word = Statusword::TARGET_REACHED;
        scene.now = ms(1_000) + time;
        let passing = |monitor: &mut SetPointMonitor| {
            (monitor.ends_in_motion, monitor.stood) = (true, None);
        };
        shown(&scene, changed(to(1_000), passing))
    };
    assert_eq!(after(BEGIN - ms(1)), None);
    assert_eq!(after(BEGIN), reached(1_500));
}

/// The one before it has swung the axis beyond this end already, and bit 10 was not low since.
#[test]
fn an_end_in_motion_is_not_passed_where_the_axis_stood_beyond_it_before() {
    let after = |stood: i32, time: Duration| {
        let mut scene = Scene::at(1_500);
        scene.word = Statusword::TARGET_REACHED;
        scene.now = ms(1_000) + time;
        let beyond = changed(to(1_000), |monitor| {
            (monitor.ends_in_motion, monitor.stood) = (true, Some(stood));
        });
        shown(&scene, beyond)
    };
    assert_eq!(after(1_500, BEGIN - ms(1)), None);
    assert_eq!(after(1_500, BEGIN), reached(1_500));
    // One that stood before its end has gone through it.
    assert_eq!(after(0, BEGIN - ms(1)), reached(1_500));
}

/// With bit 10 high, and far from both ends, for the settle time.
#[test]
fn two_have_run_on_where_the_axis_goes_away_from_both_ends_with_bit_10() {
    let runs = |first: i32, second: i32, word: Statusword| {
        let mut first = changed(to(first), |monitor| {
            (monitor.left_target, monitor.arrived) = (true, Some(first));
        });
        let second = changed(to(second), |monitor| monitor.ends_in_motion = true);
        let mut last = false;
        for (cycle, position) in (0..=SETTLE.as_millis() as u64).zip(1_400..) {
            let mut scene = Scene::at(position);
            (scene.word, scene.now) = (word, NOW + ms(cycle));
            last = scene.shows(|cycle| first.has_run_on(&second, cycle));
        }
        last
    };
    let reached = Statusword::TARGET_REACHED;
    assert!(runs(1_000, 1_100, reached));
    assert!(!runs(1_000, 1_100, Statusword::empty()));
    assert!(!runs(1_000, 1_450, reached), "it is at the second end");
    assert!(!runs(1_450, 1_000, reached), "it is at the first end");
}

/// An axis that stays within its window of where bit 10 rose rests there.
#[test]
fn two_have_not_run_on_before_the_axis_is_further_away_than_its_window() {
    let goes_on = |way: i32| {
        let mut first = changed(to(1_000), |monitor| {
            (monitor.left_target, monitor.arrived) = (true, Some(1_000));
        });
        let second = changed(to(1_100), |monitor| monitor.ends_in_motion = true);
        let mut last = false;
        for cycle in 0..=SETTLE.as_millis() as u64 {
            let mut scene = Scene::at(1_400 + way.min(cycle as i32));
            (scene.word, scene.now) = (Statusword::TARGET_REACHED, NOW + ms(cycle));
            last = scene.shows(|cycle| first.has_run_on(&second, cycle));
        }
        last
    };
    assert!(!goes_on(WINDOW) && goes_on(WINDOW + 1));
}

/// The end of a distance is not known. Bit 10 may be that of the set-point that the drive perhaps still holds before it.
#[test]
fn a_distance_that_ends_in_motion_has_passed_its_end_unless_the_drive_may_hold_another() {
    let passed = |doubted: bool| {
        let mut scene = Scene::at(400);
        scene.word = Statusword::TARGET_REACHED;
        let of_distance = changed(distance(300, base(0)), |monitor| {
            (monitor.ends_in_motion, monitor.left_target) = (true, true);
            (monitor.is_loose, monitor.doubted) = (false, doubted);
        });
        shown(&scene, of_distance)
    };
    let actual = 400;
    let unknown = Err(Failure::EndNotKnown { actual });
    assert_eq!(passed(false), Some(unknown));
    assert_eq!(passed(true), None);
}

#[test]
fn one_that_ends_in_motion_may_have_passed_its_end_before_its_turn() {
    let behind = |ends_in_motion: bool, from: i32| {
        let first = changed(to(2_000), |monitor| monitor.before = from);
        let mut second = changed(to(1_000), |monitor| monitor.ends_in_motion = ends_in_motion);
        Scene::at(1_200).shows(|cycle| second.note_behind(&first, cycle));
        second.early
    };
    assert!(behind(true, 900) && behind(true, 1_000) && !behind(true, 1_001));
    assert!(!behind(false, 900));
    // Long after that its turn comes.
    let kept = |ends_in_motion: bool| {
        let first = to(2_000);
        let mut second = changed(to(1_000), |monitor| {
            (monitor.ends_in_motion, monitor.early) = (ends_in_motion, true);
        });
        Scene::at(1_200).shows(|cycle| second.takes_over(&first, true, false, cycle));
        second.early
    };
    assert!(kept(true) && !kept(false));
}
