//! What the drive holds, and where a move would begin, count from and end.

use crate::{
    ds402::{Controlword, Mode},
    profile_position::{
        CommandId, Completion, LastSeen, Limits, PositionRange, SetPoint, Standstill,
        sequencer::{Raised, Request},
    },
};

use super::*;

const fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

/// What a cycle shows of an axis.
#[derive(Clone)]
struct Scene {
    position: i32,
    velocity: Option<i32>,
    word: Statusword,
    traits: Traits,
    limits: Limits,
    standstill: Standstill,
    bounds: Bounds,
}

const NOW: Duration = ms(20_000);

impl Scene {
    fn at(position: i32) -> Self {
        Self {
            position,
            velocity: None,
            word: Statusword::empty(),
            traits: Traits::cia402(),
            limits: Limits::trust_drive(),
            standstill: Standstill::default(),
            bounds: Bounds::new(10, Some(2), ms(100), ms(1), None),
        }
    }

    /// It has stood where it is for so long before now.
    fn stand(&mut self, time: Duration) {
        for at in (NOW - time).as_millis() as u64..=NOW.as_millis() as u64 {
            self.standstill
                .update(ms(at), self.position, None, &self.bounds);
        }
    }

    fn base(relative_base: RelativeBase) -> Self {
        let mut this = Self::at(0);
        this.traits.relative_base = relative_base;
        this
    }

    fn shows<R>(&self, of: impl FnOnce(&Cycle<'_>) -> R) -> R {
        let sample = Sample {
            statusword: self.word,
            mode: Mode::ProfilePosition,
            position: self.position,
            velocity: self.velocity,
            error_code: None,
        };
        of(&Cycle {
            now: NOW,
            sample: &sample,
            standstill: &self.standstill,
            bounds: &self.bounds,
            last_seen: &LastSeen::default(),
            traits: &self.traits,
            limits: &self.limits,
            referenced: true,
            delivered: true,
            halted: false,
            blind: 0,
            stalled: 0,
            bit_11_is_valid: true,
            acknowledge: ms(500),
            begin: ms(1_000),
            controlword: Controlword::empty(),
        })
    }
}

fn command(reference: Reference, target: i32, buffer_mode: BufferMode) -> MoveCommand {
    MoveCommand {
        reference,
        target,
        set_point: SetPoint::new().buffer_mode(buffer_mode),
        gated: false,
    }
}

fn to(target: i32, buffer_mode: BufferMode) -> MoveCommand {
    command(Reference::Absolute, target, buffer_mode)
}

fn by(distance: i32, buffer_mode: BufferMode) -> MoveCommand {
    command(Reference::Relative, distance, buffer_mode)
}

/// One that the drive has taken from an axis at rest at 0.
fn monitor(id: u32, command: MoveCommand, end: Option<i32>) -> SetPointMonitor {
    let raised = raised(id, command, end);
    Scene::at(0).shows(|cycle| SetPointMonitor::new(&raised, true, cycle))
}

/// One whose bit 4 has risen on an axis at rest at 0.
pub(super) fn raised(id: u32, command: MoveCommand, end: Option<i32>) -> Raised {
    Raised {
        request: Request {
            id: CommandId(id),
            command,
            blocked_since: None,
        },
        since: ms(1_000),
        begin: 0,
        at: 0,
        end,
        goal: end,
        previous: None,
        from_rest: true,
        stands: true,
        at_base: true,
        far_behind: false,
        behind: None,
        behind_loose: false,
        early: false,
    }
}

#[test]
fn a_set_point_that_waits_for_its_acknowledge_for_longer_than_its_deadline_has_waited_for_that() {
    let now = ms(10_000);
    for (since, kept) in [(ms(3), ms(9_500)), (ms(9_900), ms(9_900))] {
        let mut raised = raised(1, to(1_000, BufferMode::Aborting), Some(1_000));
        raised.since = since;
        raised.request.blocked_since = Some(ms(7));
        raised.canonicalize(now, ms(500));
        assert_eq!((raised.since, raised.request.blocked_since), (kept, None));
    }
}

fn held(monitors: [Option<SetPointMonitor>; 2]) -> DriveBuffer {
    DriveBuffer {
        held: monitors,
        ..DriveBuffer::default()
    }
}

/// One under way to 1000.
fn one() -> DriveBuffer {
    let first = to(1_000, BufferMode::Aborting);
    held([Some(monitor(1, first, Some(1_000))), None])
}

/// And one behind it to 2000.
fn two() -> DriveBuffer {
    let second = to(2_000, BufferMode::Buffered);
    let mut drive_buffer = one();
    drive_buffer.held[1] = Some(monitor(2, second, Some(2_000)));
    drive_buffer
}

fn after(last_end: Option<i32>) -> DriveBuffer {
    DriveBuffer {
        last_end,
        ..DriveBuffer::default()
    }
}

fn reports(mut events: Events) -> alloc::vec::Vec<(u32, Event)> {
    core::iter::from_fn(|| events.pop())
        .map(|(id, event)| (id.0, event))
        .collect()
}

#[test]
fn what_may_still_begin_is_gone_with_the_others_out_of_operation_enabled() {
    let after = |forgets: bool| {
        let mut drive_buffer = DriveBuffer {
            unseen: true,
            ..DriveBuffer::default()
        };
        if forgets {
            drive_buffer.forget();
        }
        let next = monitor(1, to(1_000, BufferMode::Buffered), Some(1_000));
        drive_buffer.push(next, &mut Events::new());
        let [first, _] = drive_buffer.held;
        first.is_some_and(|first| first.after_unseen)
    };
    assert!(after(false));
    assert!(!after(true));
}

#[test]
fn a_chain_says_what_it_holds_and_whether_a_cycle_may_be_cheap() {
    for (drive_buffer, empty, cheap) in [
        (DriveBuffer::default(), true, true),
        (one(), false, true),
        (two(), false, false),
    ] {
        let said = (drive_buffer.is_empty(), drive_buffer.allows_idle_path());
        assert_eq!(said, (empty, cheap));
    }
    let mut resumed = one();
    resumed.resumed(NOW, true);
    assert!(
        !resumed.allows_idle_path(),
        "bit 10 may be that of the halt"
    );
    let over = DriveBuffer {
        over: Some(Over {
            monitor: monitor(7, to(500, BufferMode::Aborting), Some(500)),
            next: BufferMode::Buffered,
            since: NOW,
            position: 400,
        }),
        ..one()
    };
    assert!(!over.allows_idle_path(), "an end is open");
    let mut given_up = DriveBuffer {
        not_begun: true,
        ..one()
    };
    assert!(given_up.take_not_begun() && !given_up.take_not_begun());
}

#[test]
fn a_relative_move_counts_from_the_documented_base() {
    use BufferMode::{Aborting, Blending, Buffered};
    use RelativeBase::{Actual, Demand, PositioningOption, PreviousTarget, Undocumented};
    let base = |drive_buffer: &DriveBuffer, of: RelativeBase, buffer_mode, position: i32| {
        let mut scene = Scene::base(of);
        scene.position = position;
        scene.shows(|cycle| drive_buffer.base_of(&by(5, buffer_mode), cycle))
    };
    // Behind another at the end of that.
    for of in [
        PreviousTarget,
        Demand,
        Actual,
        PositioningOption,
        Undocumented,
    ] {
        assert_eq!(base(&one(), of, Buffered, 300), Some(1_000), "{of:?}");
        assert_eq!(base(&two(), of, Blending, 300), Some(2_000), "{of:?}");
        let replacing = (of == PreviousTarget).then_some(1_000);
        assert_eq!(base(&one(), of, Aborting, 300), replacing, "{of:?}");
    }
    // Behind none where the axis is, or where the last one ended, if it is there still.
    for of in [Demand, Actual] {
        assert_eq!(base(&after(Some(1_000)), of, Aborting, 300), Some(300));
    }
    for of in [PreviousTarget, PositioningOption, Undocumented] {
        let at = |position| base(&after(Some(1_000)), of, Aborting, position);
        assert_eq!(at(1_010), Some(1_000));
        assert_eq!(at(990), Some(1_000));
        assert_eq!(at(1_011), None);
        assert_eq!(base(&after(None), of, Aborting, 1_000), None);
    }
    // Behind one that the drive may hold yet nobody knows; one that replaces it counts as ever.
    let unproven = |drive_buffer| DriveBuffer {
        unproven: true,
        ..drive_buffer
    };
    assert_eq!(base(&unproven(after(None)), Actual, Buffered, 300), None);
    assert_eq!(
        base(&unproven(after(None)), Actual, Aborting, 300),
        Some(300)
    );
    assert_eq!(base(&unproven(one()), Actual, Buffered, 300), Some(1_000));
}

#[test]
fn where_a_move_begins_leads_and_ends() {
    use BufferMode::{Aborting, Blending, Buffered};
    let scene = Scene::base(RelativeBase::Actual);
    let of = |drive_buffer: &DriveBuffer, command: MoveCommand| {
        scene.shows(|cycle| {
            (
                drive_buffer.begin_of(&command, cycle),
                drive_buffer.goal_of(&command, cycle),
                drive_buffer.end_of(&command, cycle),
            )
        })
    };
    assert_eq!(of(&one(), to(70, Aborting)), (0, Some(70), Some(70)));
    assert_eq!(of(&one(), to(70, Buffered)), (1_000, Some(70), Some(70)));
    assert_eq!(
        of(&one(), by(70, Buffered)),
        (1_000, Some(1_070), Some(1_070))
    );
    // A drive that counts from the actual position takes it on the way.
    assert_eq!(of(&two(), by(70, Blending)), (2_000, Some(2_070), None));
    assert_eq!(of(&two(), to(70, Blending)), (2_000, Some(70), Some(70)));
    assert_eq!(of(&after(None), by(70, Blending)), (0, Some(70), Some(70)));
    let previous = Scene::base(RelativeBase::PreviousTarget);
    let end = previous.shows(|cycle| one().end_of(&by(70, Blending), cycle));
    assert_eq!(end, Some(1_070));
    assert_eq!(two().previous_end(), Some(2_000));
    assert_eq!(after(Some(-7)).previous_end(), Some(-7));
    assert!(two().before(&to(70, Aborting)).is_none());
    let before = two().before(&to(70, Buffered)).map(|monitor| monitor.id);
    assert_eq!(before, Some(CommandId(2)));
}

#[test]
fn a_relative_move_beyond_a_limit_is_refused_where_its_end_is_known() {
    let mut scene = Scene::base(RelativeBase::Actual);
    scene.position = 300;
    scene.limits.software = Some(PositionRange {
        min: -1_000,
        max: 1_000,
    });
    let check = |scene: &Scene, drive_buffer: &DriveBuffer, command: MoveCommand| {
        scene.shows(|cycle| drive_buffer.check_limits(&command, cycle).is_ok())
    };
    let none = after(None);
    assert!(check(&scene, &none, by(700, BufferMode::Aborting)));
    assert!(!check(&scene, &none, by(701, BufferMode::Aborting)));
    assert!(check(&scene, &none, by(-1_300, BufferMode::Aborting)));
    assert!(!check(&scene, &none, by(-1_301, BufferMode::Aborting)));
    assert!(check(&scene, &one(), by(0, BufferMode::Buffered)));
    assert!(!check(&scene, &one(), by(1, BufferMode::Buffered)));
    // Positions were checked when they were asked for.
    assert!(check(&scene, &none, to(5_000, BufferMode::Aborting)));
    // What nobody knows is not checked.
    scene.traits.relative_base = RelativeBase::Undocumented;
    assert!(check(&scene, &none, by(701, BufferMode::Aborting)));
    // Beyond the ends of 32 bits it is no small number again.
    scene.traits.relative_base = RelativeBase::Actual;
    assert!(!check(&scene, &none, by(i32::MAX, BufferMode::Aborting)));
    let turn = PositionRange { min: 0, max: 3_599 };
    scene.bounds = Bounds::new(10, Some(2), ms(100), ms(1), Some(turn));
    assert!(check(&scene, &none, by(3_600 + 700, BufferMode::Aborting)));
    assert!(!check(&scene, &none, by(3_600 + 701, BufferMode::Aborting)));
}

#[test]
fn an_axis_that_is_near_an_end_may_have_been_led_by_either() {
    let bounds = Scene::at(0).bounds;
    for (position, near) in [(1_030, true), (970, true), (1_031, false), (969, false)] {
        assert_eq!(one().ends_near(position, &bounds), near, "{position}");
    }
    assert!(two().ends_near(2_000, &bounds) && !after(Some(5)).ends_near(5, &bounds));
    // A distance may end where it leads from a base that nobody knows.
    let distance = monitor(1, by(400, BufferMode::Aborting), None);
    let loose = held([Some(distance), None]);
    assert!(loose.ends_near(400, &bounds) && !loose.ends_near(500, &bounds));
}

#[test]
fn an_axis_stands_at_the_last_end_by_606ch_or_by_its_own_time() {
    let stands = |drive_buffer: &DriveBuffer, position: i32, velocity: Option<i32>| {
        let mut scene = Scene::at(position);
        scene.velocity = velocity;
        scene.shows(|cycle| drive_buffer.stands(cycle))
    };
    let ended = after(Some(1_000));
    assert!(stands(&ended, 1_010, Some(2)) && stands(&ended, 990, Some(-2)));
    assert!(!stands(&ended, 1_011, Some(0)));
    assert!(!stands(&ended, 1_000, Some(3)) && !stands(&ended, 1_000, Some(-3)));
    assert!(!stands(&ended, 1_000, None));
    assert!(!stands(&after(None), 1_000, Some(0)));
    assert!(!stands(&one(), 1_000, Some(0)), "one is under way");
    // For the settle time since the last one has ended.
    let mut scene = Scene::at(7);
    scene.stand(ms(1_000));
    let since = |ended: u64| {
        let drive_buffer = DriveBuffer {
            ended: ms(ended),
            ..DriveBuffer::default()
        };
        scene.shows(|cycle| drive_buffer.stands(cycle))
    };
    assert!(since(19_900) && !since(19_901));
    let drive_buffer = one();
    assert!(!scene.shows(|cycle| drive_buffer.stands(cycle)));
    // A move that is queued begins at rest in any case.
    let rests = |scene: &Scene, drive_buffer: &DriveBuffer, buffer_mode| {
        scene.shows(|cycle| drive_buffer.begins_at_rest(&to(5, buffer_mode), cycle))
    };
    assert!(rests(&scene, &drive_buffer, BufferMode::Buffered));
    assert!(!rests(&scene, &drive_buffer, BufferMode::Blending));
    assert!(!rests(&scene, &drive_buffer, BufferMode::Aborting));
    assert!(rests(&scene, &DriveBuffer::default(), BufferMode::Aborting));
}

/// Behind one that the drive may hold yet there is no second place, but for a move that replaces both.
#[test]
fn behind_one_in_doubt_only_what_replaces_it_has_a_place() {
    let mut scene = Scene::at(500);
    scene.traits.buffer_signal = BufferSignal::Acknowledge;
    let place = |drive_buffer: &DriveBuffer, command: MoveCommand| {
        scene.shows(|cycle| match drive_buffer.place_for(&command, cycle) {
            BufferRoom::Free => "free",
            BufferRoom::Full => "full",
            BufferRoom::Later => "later",
            BufferRoom::Never(_) => "never",
        })
    };
    let unproven = DriveBuffer {
        unproven: true,
        ..one()
    };
    for (drive_buffer, buffered, absolute, relative) in [
        (DriveBuffer::default(), "free", "free", "free"),
        (one(), "free", "free", "free"),
        (unproven, "later", "free", "free"),
        (two(), "later", "full", "never"),
    ] {
        assert_eq!(place(&drive_buffer, to(70, BufferMode::Buffered)), buffered);
        assert_eq!(place(&drive_buffer, to(70, BufferMode::Blending)), buffered);
        assert_eq!(place(&drive_buffer, to(70, BufferMode::Aborting)), absolute);
        assert_eq!(place(&drive_buffer, by(70, BufferMode::Aborting)), relative);
    }
}

/// One whose end was reported leads the axis: the drive may have another behind it.
#[test]
fn nothing_is_queued_behind_what_leads_the_axis_without_a_set_point() {
    let is_free = |scene: &Scene, unproven: bool, buffer_mode| {
        let drive_buffer = DriveBuffer {
            unproven,
            ..DriveBuffer::default()
        };
        scene.shows(|cycle| {
            let room = drive_buffer.place_for(&to(70, buffer_mode), cycle);
            matches!(room, BufferRoom::Free)
        })
    };
    use BufferMode::{Aborting, Blending, Buffered};
    let scene = Scene::at(500);
    assert!(!is_free(&scene, true, Buffered) && !is_free(&scene, true, Blending));
    assert!(is_free(&scene, true, Aborting) && is_free(&scene, false, Buffered));
    let mut reached = Scene::at(500);
    reached.word = Statusword::TARGET_REACHED;
    let mut stands = Scene::at(500);
    stands.stand(ms(150));
    assert!(is_free(&reached, true, Buffered) && is_free(&stands, true, Buffered));
}

/// Without a word of bit 12 the position has to show that the active one has ended.
#[test]
fn a_place_that_bit_12_does_not_show_is_free_where_the_position_will_show_the_end() {
    let place_at = |position, signal, drive_buffer: &DriveBuffer, command: MoveCommand| {
        let mut scene = Scene::at(position);
        scene.traits.buffer_signal = signal;
        scene.shows(|cycle| match drive_buffer.place_for(&command, cycle) {
            BufferRoom::Free => "free",
            BufferRoom::Full => "full",
            BufferRoom::Later => "later",
            BufferRoom::Never(_) => "never",
        })
    };
    let place =
        |signal, drive_buffer: &DriveBuffer, command| place_at(500, signal, drive_buffer, command);
    use BufferMode::{Aborting, Blending, Buffered};
    for signal in [BufferSignal::None, BufferSignal::Unknown] {
        // Bit 11 was not seen low: the drive may have limited the move.
        assert_eq!(place(signal, &one(), to(70, Buffered)), "later");
        assert_eq!(place(signal, &one(), to(70, Blending)), "later");
        let mut seen = one();
        seen.held
            .iter_mut()
            .flatten()
            .for_each(|monitor| monitor.note_limit(Statusword::empty()));
        assert_eq!(place(signal, &seen, to(70, Buffered)), "free");
        assert_eq!(place(signal, &seen, to(70, Blending)), "free");
        // One that follows another that may begin yet has not moved the axis.
        let mut doubtful = seen.clone();
        let monitors = doubtful.held.iter_mut().flatten();
        monitors.for_each(|monitor| monitor.comes_after_doubt(false));
        assert_eq!(place(signal, &doubtful, to(70, Buffered)), "free");
        assert_eq!(place_at(10, signal, &doubtful, to(70, Buffered)), "later");
        // An end that neither shows, and one that the position shows many times.
        let nowhere = held([Some(monitor(1, by(400, Aborting), None)), None]);
        assert_eq!(place(signal, &nowhere, to(70, Blending)), "never");
        assert_eq!(place(signal, &nowhere, to(70, Buffered)), "later");
        let mut turning = one();
        turning
            .held
            .iter_mut()
            .flatten()
            .for_each(|monitor| monitor.turns = true);
        assert_eq!(place(signal, &turning, to(70, Blending)), "never");
        assert_eq!(place(signal, &turning, to(70, Buffered)), "later");
    }
    // A full buffer: bit 12 that is high may be that of it, or is of the handshake.
    assert_eq!(place(BufferSignal::None, &two(), to(70, Aborting)), "free");
    assert_eq!(place(BufferSignal::None, &two(), by(70, Aborting)), "free");
    assert_eq!(
        place(BufferSignal::Unknown, &two(), to(70, Aborting)),
        "full"
    );
    assert_eq!(
        place(BufferSignal::Unknown, &two(), by(70, Aborting)),
        "free"
    );
    assert_eq!(place(BufferSignal::None, &two(), to(70, Buffered)), "later");
}

#[test]
fn what_replaces_all_ends_them_and_what_follows_one_in_doubt_is_in_doubt() {
    let mut events = Events::new();
    let mut drive_buffer = DriveBuffer {
        unproven: true,
        at_base: true,
        last_end: Some(5),
        unseen: true,
        ..two()
    };
    drive_buffer.push(
        monitor(3, to(7, BufferMode::Aborting), Some(7)),
        &mut events,
    );
    let superseded = Event::Done(Err(Failure::Superseded));
    assert_eq!(reports(events), [(1, superseded), (2, superseded)]);
    assert!(!drive_buffer.is_unproven() && !drive_buffer.is_at_base());
    assert_eq!(drive_buffer.last_end, None);
    let ids = drive_buffer
        .held
        .map(|monitor| monitor.map(|monitor| monitor.id.0));
    assert_eq!(ids, [Some(3), None]);

    let first_of = |drive_buffer: &DriveBuffer| {
        let monitor = drive_buffer.held[0].expect("one is held");
        Scene::at(0).shows(|cycle| monitor.is_surely_first(cycle))
    };
    for (unseen, unproven, buffer_mode, first) in [
        (false, false, BufferMode::Buffered, true),
        (true, false, BufferMode::Buffered, false),
        (false, true, BufferMode::Buffered, false),
        (true, true, BufferMode::Aborting, true),
    ] {
        let mut drive_buffer = DriveBuffer {
            unseen,
            unproven,
            ..DriveBuffer::default()
        };
        let monitor = monitor(3, to(1_000, buffer_mode), Some(1_000));
        drive_buffer.push(monitor, &mut Events::new());
        assert_eq!(
            first_of(&drive_buffer),
            first,
            "{unseen} {unproven} {buffer_mode:?}"
        );
    }
}

#[test]
fn each_of_them_is_told_once_that_it_is_halted() {
    let mut events = Events::new();
    let mut drive_buffer = two();
    drive_buffer.report_halted(&mut events);
    drive_buffer.report_halted(&mut events);
    let told = [(1, Event::Halted), (2, Event::Halted)];
    assert_eq!(reports(events), told);
    // Only the active one begins where the axis was when it was resumed.
    drive_buffer.resumed(NOW, false);
    let from_rest = drive_buffer
        .held
        .map(|monitor| monitor.map(|monitor| monitor.from_rest));
    assert_eq!(from_rest, [Some(false), Some(true)]);
    let mut events = Events::new();
    drive_buffer.report_halted(&mut events);
    assert_eq!(reports(events), told, "by the next halt");
}

/// The last one ends by bit 10 alone; with another one on its way only where its own end is known, and that has not replaced it.
#[test]
fn what_shows_with_another_on_its_way_is_the_end_where_that_is_known() {
    let ended = |mut drive_buffer: DriveBuffer, next: Unacknowledged, undecided: bool| {
        let mut scene = Scene::at(1_000);
        scene.shows(|cycle| {
            drive_buffer.follow_active(cycle, Unacknowledged::None, false, &mut Events::new())
        });
        scene.word = Statusword::TARGET_REACHED;
        let mut events = Events::new();
        let over =
            scene.shows(|cycle| drive_buffer.follow_active(cycle, next, undecided, &mut events));
        assert_eq!(over, drive_buffer.is_empty());
        assert_eq!(over, !reports(events).is_empty());
        (over, drive_buffer.last_end, drive_buffer.is_at_base())
    };
    let over = (true, Some(1_000), true);
    let open = (false, None, false);
    assert_eq!(ended(one(), Unacknowledged::None, false), over);
    assert_eq!(
        ended(one(), Unacknowledged::None, true),
        open,
        "the one before is open"
    );
    assert_eq!(
        ended(one(), Unacknowledged::Comes { replaces: false }, false),
        over
    );
    assert_eq!(
        ended(one(), Unacknowledged::Comes { replaces: true }, false),
        open
    );
    let distance = || {
        held([
            Some(monitor(1, by(1_000, BufferMode::Aborting), None)),
            None,
        ])
    };
    assert_eq!(
        ended(distance(), Unacknowledged::None, false),
        (true, None, true)
    );
    assert_eq!(
        ended(distance(), Unacknowledged::Comes { replaces: false }, false),
        open
    );
}

/// Bit 12 and an open end show together that the drive is at the second one. Then it arrives. Else it is there too early.
#[test]
fn the_second_one_arrives_where_bit_12_shows_the_drive_at_it_and_the_first_is_open() {
    let second_at_its_end = |room_shown: bool, open: bool| {
        let mut scene = Scene::at(2_000);
        scene.traits.buffer_signal = BufferSignal::Acknowledge;
        let mut drive_buffer = two();
        drive_buffer.over = open.then(|| Over {
            monitor: monitor(7, to(500, BufferMode::Aborting), Some(500)),
            next: BufferMode::Buffered,
            since: NOW,
            position: 400,
        });
        let mut events = Events::new();
        for _ in 0..2 {
            scene.shows(|cycle| {
                let room = room_shown.then_some(Room::Sure);
                drive_buffer.follow(cycle, room, Unacknowledged::None, &mut events);
            });
        }
        let takeover = drive_buffer.takeover.map(|takeover| takeover.monitor);
        let seen = takeover.or(drive_buffer.held[1]);
        seen.and_then(|second| second.arrived)
    };
    assert_eq!(second_at_its_end(true, true), Some(2_000));
    assert_eq!(second_at_its_end(true, false), None);
    assert_eq!(second_at_its_end(false, true), None);
    assert_eq!(second_at_its_end(false, false), None);
}

/// Without bit 10 it is not at rest. It waits no longer than the time to begin.
#[test]
fn one_in_doubt_that_never_shows_bit_10_is_perhaps_superseded() {
    let after = |stood: Duration| {
        let mut scene = Scene::at(1_000);
        scene.stand(ms(1_000));
        let mut drive_buffer = one();
        let monitors = drive_buffer.held.iter_mut().flatten();
        monitors.for_each(|monitor| {
            for quarters in (0..=4).rev() {
                let at = NOW - stood / 4 * quarters;
                monitor.unreached.update(at, true, ms(1_000));
            }
        });
        let next = Unacknowledged::Perhaps { anywhere: false };
        let mut events = Events::new();
        scene.shows(|cycle| drive_buffer.follow(cycle, None, next, &mut events));
        (reports(events), drive_buffer.is_empty())
    };
    let superseded = Failure::PerhapsSuperseded { actual: 1_000 };
    let done = Event::Done(Err(superseded));
    assert_eq!(after(ms(1_000)), (alloc::vec![(1, done)], true));
    assert_eq!(after(ms(999)), (alloc::vec![], false));
}

#[test]
fn one_that_ends_well_and_was_not_seen_to_begin_may_begin_yet() {
    let unseen = |left_target: bool, position: i32| {
        let mut drive_buffer = one();
        let monitors = drive_buffer.held.iter_mut().flatten();
        monitors.for_each(|monitor| {
            monitor.left_target = left_target;
            (monitor.before, monitor.stood) = (position, Some(position));
            (monitor.since, monitor.low) = (ms(1_000), ms(1_000));
        });
        let mut scene = Scene::at(position);
        scene.word = Statusword::TARGET_REACHED;
        scene.stand(ms(1_000));
        let mut events = Events::new();
        let next = Unacknowledged::None;
        scene.shows(|cycle| drive_buffer.follow_active(cycle, next, false, &mut events));
        let [(_, Event::Done(outcome))] = reports(events)[..] else {
            panic!("it has not ended");
        };
        (outcome.is_ok(), drive_buffer.unseen)
    };
    assert_eq!(unseen(true, 1_000), (true, false));
    assert_eq!(unseen(false, 1_000), (true, true));
    assert_eq!(unseen(false, 0), (false, false));
}

/// Where bit 12 has shown that the next one has taken over, the axis has the settle time to show itself at the end.
#[test]
fn an_end_that_bit_12_has_shown_is_waited_for_until_the_settle_time_is_over() {
    let after = |waited: u64, position: i32| {
        let first = monitor(1, to(1_000, BufferMode::Aborting), Some(1_000));
        let mut over = monitor(2, to(2_000, BufferMode::Buffered), Some(2_000));
        over.note_limit(Statusword::empty());
        let mut drive_buffer = held([Some(over), None]);
        let mut first = first;
        first.note_limit(Statusword::empty());
        drive_buffer.over = Some(Over {
            monitor: first,
            next: BufferMode::Buffered,
            since: NOW - ms(waited),
            position: 600,
        });
        let mut events = Events::new();
        let open = Scene::at(position).shows(|cycle| drive_buffer.follow_over(cycle, &mut events));
        assert_eq!(open, drive_buffer.over.is_some());
        (open, reports(events))
    };
    assert_eq!(after(99, 300), (true, alloc::vec![]));
    let missed = Failure::MissedTarget {
        target: 1_000,
        actual: 600,
    };
    let done = Event::Done(Err(missed));
    assert_eq!(after(100, 300), (false, alloc::vec![(1, done)]));
    let position = 1_005;
    let reached = Event::Done(Ok(Completion::Reached { position }));
    assert_eq!(after(0, 1_005), (false, alloc::vec![(1, reached)]));
}

/// What is reported of two, of which the axis has stood for the time to begin where `position` says, and what is held then.
fn at_rest_with_two(
    position: i32,
    left_target: bool,
    bit_12_has_fallen: bool,
) -> (alloc::vec::Vec<(u32, Event)>, DriveBuffer) {
    let mut scene = Scene::at(position);
    scene.stand(ms(2_000));
    let mut drive_buffer = two();
    for monitor in drive_buffer.held.iter_mut().flatten() {
        (monitor.since, monitor.low) = (ms(1_000), ms(1_000));
    }
    let first = drive_buffer.held[0].as_mut().expect("one is held");
    first.left_target = left_target;
    first.arrived = left_target.then_some(1_000);
    first.note_limit(Statusword::empty());
    // Then only rest and bit 12 say that the first is over.
    scene.traits.buffer_signal = BufferSignal::Acknowledge;
    if bit_12_has_fallen {
        for at in [19_000, 19_250, 19_500, 19_750, 20_000] {
            first.unreached.update(ms(at), true, ms(1_000));
        }
    } else {
        scene.word = Statusword::TARGET_REACHED;
        first.resting = Some(NOW - ms(1_000));
    }
    let mut events = Events::new();
    let none = Unacknowledged::None;
    let room = bit_12_has_fallen.then_some(Room::Sure);
    scene.shows(|cycle| drive_buffer.follow(cycle, room, none, &mut events));
    (reports(events), drive_buffer)
}

#[test]
fn two_that_have_come_to_rest_at_the_end_of_the_second_leave_nothing_in_doubt() {
    let (reported, drive_buffer) = at_rest_with_two(2_000, true, false);
    let reached = Event::Done(Ok(Completion::Reached { position: 1_000 }));
    assert_eq!(reported, [(1, reached)]);
    assert!(!drive_buffer.is_unproven());
    let [Some(second), None] = &drive_buffer.held else {
        panic!("the second is not the active one");
    };
    assert!(second.id == CommandId(2) && !second.doubted);
}

#[test]
fn of_two_at_rest_at_the_end_of_the_first_the_second_has_not_begun() {
    let reached = Event::Done(Ok(Completion::Reached { position: 1_000 }));
    let not_begun = |actual| Event::Done(Err(Failure::NotBegun { actual }));
    for (position, left_target, first) in [(1_000, true, reached), (0, false, not_begun(0))] {
        let (reported, mut drive_buffer) = at_rest_with_two(position, left_target, false);
        assert_eq!(reported, [(1, first), (2, not_begun(position))]);
        assert!(drive_buffer.is_empty() && drive_buffer.take_not_begun());
    }
}

#[test]
fn where_a_place_began_to_show_is_of_these_two() {
    let mut scene = Scene::at(1_000);
    scene.traits.buffer_signal = BufferSignal::Acknowledge;
    let mut drive_buffer = two();
    drive_buffer.held[1] = None;
    let first = drive_buffer.held[0].expect("one is held");
    drive_buffer.takeover = Some(Takeover {
        monitor: first,
        position: 700,
        at_end: true,
    });
    let mut events = Events::new();
    let second = monitor(2, to(2_000, BufferMode::Blending), Some(2_000));
    drive_buffer.push(second, &mut events);
    let first = drive_buffer.held[0].as_mut().expect("one is held");
    first.arrived = Some(1_000);
    let (room, none) = (Some(Room::Sure), Unacknowledged::None);
    scene.shows(|cycle| drive_buffer.follow(cycle, room, none, &mut events));
    let passed = Event::Done(Ok(Completion::Passed { position: 1_000 }));
    assert_eq!(reports(events), [(1, passed)]);
}

#[test]
fn a_stall_of_the_host_counts_where_another_may_have_taken_over_meanwhile() {
    let unseen = |mut drive_buffer: DriveBuffer, next| {
        let scene = Scene::at(900);
        let mut events = Events::new();
        scene.shows(|cycle| {
            let stalled = Cycle {
                stalled: 3,
                ..*cycle
            };
            drive_buffer.follow(&stalled, None, next, &mut events);
        });
        let first = drive_buffer.held[0].expect("one is held");
        first.unseen < u32::MAX
    };
    assert!(!unseen(one(), Unacknowledged::None));
    for replaces in [false, true] {
        assert!(unseen(one(), Unacknowledged::Comes { replaces }));
    }
    assert!(unseen(two(), Unacknowledged::None));
}

/// The active one after these cycles, each with a position and what bit 12 shows, of two that a drive holds.
fn follow_two(
    mut drive_buffer: DriveBuffer,
    shown: &[(i32, Option<Room>)],
) -> (SetPointMonitor, DriveBuffer) {
    let mut events = Events::new();
    for &(position, room) in shown {
        let mut scene = Scene::at(position);
        scene.stand(ms(1_000));
        scene.traits.buffer_signal = BufferSignal::Acknowledge;
        scene.shows(|cycle| {
            drive_buffer.follow(cycle, room, Unacknowledged::None, &mut events);
        });
    }
    (drive_buffer.held[0].expect("one is held"), drive_buffer)
}

#[test]
fn where_one_word_shows_a_place_the_second_begins_when_the_next_does() {
    let (shown, sure) = (Some(Room::Shown), Some(Room::Sure));
    let cycles = [(700, shown), (900, None), (1_000, shown), (1_005, sure)];
    let (active, drive_buffer) = follow_two(two(), &cycles[..2]);
    assert_eq!(active.id, CommandId(1));
    let (active, _) = follow_two(drive_buffer, &cycles[2..]);
    assert_eq!((active.id, active.begun_at), (CommandId(2), 1_000));
}

/// Its way begins at that end, too.
#[test]
fn the_first_may_come_to_its_end_while_bit_12_is_not_sure_yet() {
    let cycles = [(950, Some(Room::Shown)), (1_000, Some(Room::Sure))];
    let (active, _) = follow_two(two(), &cycles);
    assert_eq!((active.id, active.stood), (CommandId(2), Some(1_000)));
}

#[test]
fn after_a_halt_the_turn_of_the_second_comes_anew() {
    let (_, mut drive_buffer) = follow_two(two(), &[(700, Some(Room::Shown))]);
    drive_buffer.resumed(NOW, true);
    let cycles = [(800, Some(Room::Shown)), (805, Some(Room::Sure))];
    let (active, _) = follow_two(drive_buffer, &cycles);
    assert_eq!((active.id, active.begun_at), (CommandId(2), 800));
}

/// Bit 12 has fallen: whatever bit 10 says of the time before, only the first is over.
#[test]
fn of_two_at_rest_only_the_first_is_over_where_bit_12_shows_that() {
    let (reported, mut drive_buffer) = at_rest_with_two(1_000, true, true);
    let reached = Event::Done(Ok(Completion::Reached { position: 1_000 }));
    assert_eq!(reported, [(1, reached)]);
    assert!(!drive_buffer.take_not_begun());
    let held = drive_buffer
        .held
        .map(|monitor| monitor.map(|monitor| monitor.id.0));
    assert_eq!(held, [Some(2), None]);
}

/// Behind one that ends in motion the axis is elsewhere when the drive takes the next, and does not begin at rest.
#[test]
fn what_follows_one_that_ends_in_motion_begins_in_motion() {
    let in_motion = |drive_buffer| DriveBuffer {
        ends_in_motion: true,
        ..drive_buffer
    };
    let (passing, passed) = (in_motion(one()), in_motion(after(Some(1_000))));
    for buffer_mode in [BufferMode::Aborting, BufferMode::Buffered] {
        for drive_buffer in [&passing, &passed] {
            for (of, base) in [
                (RelativeBase::Actual, None),
                (RelativeBase::Demand, None),
                (RelativeBase::Undocumented, None),
                (RelativeBase::PreviousTarget, Some(1_000)),
            ] {
                let mut scene = Scene::base(of);
                scene.position = 1_005;
                let command = by(5, buffer_mode);
                scene.shows(|cycle| {
                    assert_eq!(drive_buffer.base_of(&command, cycle), base, "{of:?}");
                    assert!(!drive_buffer.begins_at_rest(&command, cycle));
                });
            }
        }
    }
    // Where an input of its drive holds it, it stands.
    let mut scene = Scene::at(7);
    scene.stand(ms(1_000));
    let stands = |cycle: &Cycle<'_>| passed.begins_at_rest(&to(5, BufferMode::Buffered), cycle);
    assert!(scene.shows(stands));
}

#[test]
fn one_that_ends_in_motion_runs_on_until_another_is_taken() {
    let ended = |ends_in_motion: bool| {
        let mut first = monitor(1, to(1_000, BufferMode::Aborting), Some(1_000));
        (first.left_target, first.ends_in_motion) = (true, ends_in_motion);
        let mut drive_buffer = DriveBuffer::default();
        drive_buffer.push(first, &mut Events::new());
        let mut scene = Scene::at(1_005);
        scene.word = Statusword::TARGET_REACHED;
        let next = Unacknowledged::None;
        let over =
            scene.shows(|cycle| drive_buffer.follow_active(cycle, next, false, &mut Events::new()));
        assert!(over);
        drive_buffer
    };
    assert!(!ended(false).ends_in_motion && ended(false).is_at_base());
    let mut passed = ended(true);
    assert!(passed.ends_in_motion && !passed.is_at_base());
    let next = monitor(2, to(7, BufferMode::Buffered), Some(7));
    passed.push(next, &mut Events::new());
    assert!(!passed.ends_in_motion);
    let mut passed = ended(true);
    passed.forget();
    assert!(!passed.ends_in_motion);
}

/// Another has perhaps replaced it, and the axis has come to rest within its window. One that ends in motion rests nowhere.
#[test]
fn one_in_doubt_that_ends_in_motion_has_not_come_to_rest_at_its_end() {
    let ended = |ends_in_motion: bool| {
        let mut drive_buffer = one();
        let monitors = drive_buffer.held.iter_mut().flatten();
        monitors.for_each(|monitor| {
            (monitor.since, monitor.low) = (ms(1_000), ms(1_000));
            (monitor.left_target, monitor.ends_in_motion) = (true, ends_in_motion);
        });
        let mut scene = Scene::at(1_005);
        scene.word = Statusword::TARGET_REACHED;
        scene.stand(ms(1_000));
        let next = Unacknowledged::Perhaps { anywhere: false };
        let mut events = Events::new();
        scene.shows(|cycle| drive_buffer.follow(cycle, None, next, &mut events));
        reports(events)
    };
    let done = |result| alloc::vec![(1, Event::Done(result))];
    let position = 1_005;
    assert_eq!(ended(false), done(Ok(Completion::Reached { position })));
    let superseded = Failure::PerhapsSuperseded { actual: 1_005 };
    assert_eq!(ended(true), done(Err(superseded)));
}

/// With a drive that may count from elsewhere.
#[test]
fn a_distance_is_loose_where_the_axis_may_lag_so_far_behind_a_demand_that_has_ended() {
    let command = MoveCommand {
        reference: Reference::Relative,
        ..to(5, BufferMode::Blending)
    };
    // It goes 3 counts in a millisecond, so 120 in 40 ms.
    for (previous, loose) in [(120, true), (-120, true), (121, false), (-121, false)] {
        let raised = Raised {
            since: NOW - ms(4),
            previous: Some(previous),
            from_rest: false,
            stands: false,
            far_behind: true,
            ..raised(1, command, Some(previous + 5))
        };
        let mut scene = Scene::at(12);
        scene.traits.relative_base = RelativeBase::Undocumented;
        let monitor = scene.shows(|cycle| SetPointMonitor::new(&raised, true, cycle));
        assert_eq!(monitor.is_loose, loose, "{previous}");
    }
}

/// A drive that goes one way alone goes nearly round for it, and shows bit 10 until it sets off.
#[test]
fn a_distance_may_lead_round_for_one_that_it_replaces() {
    let turn = PositionRange { min: 0, max: 3_599 };
    let round = |turn: Option<PositionRange>, first: (MoveCommand, i32), next, at: i32| {
        let mut scene = Scene::at(0);
        scene.bounds = Bounds::new(10, Some(2), ms(100), ms(1), turn);
        let begun = |(command, end): (MoveCommand, i32), scene: &Scene| {
            let raised = raised(1, command, Some(end));
            scene.shows(|cycle| SetPointMonitor::new(&raised, true, cycle))
        };
        let mut replaced = begun(first, &scene);
        scene.position = at;
        scene.shows(|cycle| replaced.note(cycle, true));
        let mut drive_buffer = held([Some(replaced), None]);
        let mut raised = raised(2, next, Some(at));
        scene.shows(|cycle| drive_buffer.accept(&mut raised, true, cycle, &mut Events::new()));
        let taken = drive_buffer.held.iter().flatten().last();
        taken.is_some_and(|monitor| monitor.leads_round)
    };
    let some = Some(turn);
    let back = |target| (to(target, BufferMode::Aborting), target);
    let short = by(-5, BufferMode::Aborting);
    assert!(round(some, back(3_580), short, 3_595));
    // It sets off, it has no way, it leads to a place, it queues, or the axis does not turn.
    assert!(!round(some, back(3_500), short, 3_589));
    assert!(!round(some, back(3_592), short, 3_595));
    assert!(!round(
        some,
        back(3_580),
        to(3_590, BufferMode::Aborting),
        3_595
    ));
    assert!(!round(
        some,
        back(3_580),
        by(-5, BufferMode::Buffered),
        3_595
    ));
    assert!(!round(None, back(30), short, 5));
    // So may one that replaces a distance that leads round.
    let distance = |way, end| (by(way, BufferMode::Aborting), end);
    assert!(round(some, distance(3_605, 5), short, 5));
    assert!(!round(some, distance(5, 5), short, 5));
}

/// It has led the axis nowhere that anybody knows.
#[test]
fn a_short_distance_behind_one_that_ended_in_an_error_has_no_known_end() {
    let short = |position: i32, distance: i32, end: Option<i32>| {
        let raised = Raised {
            begin: position,
            ..raised(2, by(distance, BufferMode::Blending), end)
        };
        Scene::at(position).shows(|cycle| SetPointMonitor::new(&raised, true, cycle))
    };
    // Bit 12 has shown its turn before the axis was at the end of the first.
    let after = |position: i32, second: SetPointMonitor| {
        let mut first = monitor(1, to(1_000, BufferMode::Aborting), Some(1_000));
        first.note_limit(Statusword::empty());
        let mut drive_buffer = held([Some(second), None]);
        drive_buffer.over = Some(Over {
            monitor: first,
            next: BufferMode::Blending,
            since: NOW - ms(100),
            position,
        });
        Scene::at(position).shows(|cycle| {
            drive_buffer.follow_over(cycle, &mut Events::new());
            let second = drive_buffer.held[0].expect("one is held");
            second.ended_into(BufferMode::Blending, cycle)
        })
    };
    let passed = |position| Ok(Completion::Passed { position });
    let unknown = |actual| Err(Failure::EndNotKnown { actual });
    assert_eq!(after(300, short(300, -5, None)), unknown(300));
    assert_eq!(after(300, short(200, -5, None)), passed(300));
    assert_eq!(after(1_005, short(1_005, -5, None)), passed(1_005));
    assert_eq!(after(300, short(300, -5, Some(295))), passed(300));

    // The first is a distance that the drive has limited.
    let behind = |limited: bool| {
        let mut first = monitor(1, by(1_000, BufferMode::Aborting), None);
        first.limited = limited;
        let mut drive_buffer = held([Some(first), Some(short(500, -5, None))]);
        let mut scene = Scene::at(500);
        scene.traits.buffer_signal = BufferSignal::Acknowledge;
        let (room, none) = (Some(Room::Sure), Unacknowledged::None);
        scene.shows(|cycle| {
            drive_buffer.follow(cycle, room, none, &mut Events::new());
            let second = drive_buffer.held[0].expect("one is held");
            second.ended_into(BufferMode::Blending, cycle)
        })
    };
    assert_eq!(behind(true), unknown(500));
    assert_eq!(behind(false), passed(500));
}
