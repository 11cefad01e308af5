//! Moves that start together: all in one frame, or none.

use std::{
    pin::pin,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
        mpsc,
    },
    task::{Context, Wake, Waker},
    time::Duration,
};

use servocrab::{
    AxisError, BufferMode, Doubt, Failure, ProfilePosition, SetPoint,
    axis::{AxisErrorKind, Delivery},
    profile_position::{Limits, MoveRequest, PositionRange, RelativeBase},
    start_together,
    units::{Mm, Ratio, Scale},
};

use crate::machine::{Machine, Task, Variant, lock};

fn machine(axes: usize) -> (Machine, Vec<ProfilePosition>) {
    machine_of(axes, &Variant::default())
}

fn machine_of(axes: usize, variant: &Variant) -> (Machine, Vec<ProfilePosition>) {
    let mut machine = Machine::of(axes, variant);
    let leases = (0..axes)
        .map(|n| {
            let axis = machine.axis(n);
            machine.finish(axis.enable()).unwrap();
            machine.finish(axis.profile_position()).unwrap()
        })
        .collect();
    (machine, leases)
}

fn rises(machine: &Machine, axis: usize) -> Vec<usize> {
    let words = &machine.stations[axis].words;
    (1..words.len())
        .filter(|&n| words[n] & 0x10 != 0 && words[n - 1] & 0x10 == 0)
        .collect()
}

#[test]
fn each_axis_of_a_group_that_halts_on_drop_is_halted_while_the_first_is_awaited() {
    let (mut machine, pp) = machine(2);
    let halting = SetPoint::new().halt_on_drop();
    let mut task = Task::new(async {
        let [x, y] = [&pp[0], &pp[1]].map(|pp| pp.abs(90_000, halting));
        for motion in start_together([x, y]).await? {
            motion.done().await?;
        }
        Ok::<(), AxisError>(())
    });
    machine.run_beside(&mut task, 60);
    drop(task);
    machine.cycle();
    for pp in &pp {
        assert!(pp.axis().status().halted);
    }
    machine.run(2_000);
    for station in &machine.stations {
        let position = lock(&station.drive).position();
        assert!(position < 80_000, "{position}");
    }
}

#[test]
fn bits_4_of_all_axes_rise_in_one_frame() {
    let (mut machine, pp) = machine(3);
    // The first axis is busy with a handshake of its own, so that it is ready later than the others.
    let alone = machine.finish(pp[0].move_abs(10, SetPoint::new())).unwrap();
    let requests: Vec<_> = pp.iter().map(|pp| pp.abs(5_000, SetPoint::new())).collect();
    let moves = machine.finish(start_together(requests)).unwrap();
    assert_eq!(moves.len(), 3);
    for moved in &moves {
        machine.finish(moved.done()).unwrap();
    }
    let last: Vec<_> = (0..3)
        .map(|n| *rises(&machine, n).last().unwrap())
        .collect();
    assert!(last.iter().all(|rise| *rise == last[0]), "{last:?}");
    assert!(alone.outcome().is_some());
    for station in &machine.stations {
        let off = lock(&station.drive).position() - 5_000;
        assert!(off.abs() <= 10, "{off}");
    }
}

/// Whether a drive may have seen anything of moves that were to start together.
fn was_sent(error: &AxisError) -> bool {
    matches!(error.kind, AxisErrorKind::NotAllStarted { .. })
}

#[test]
fn none_starts_when_one_is_refused() {
    let (mut machine, pp) = machine(3);
    machine.finish(pp[1].axis().disable()).unwrap();
    let requests: Vec<_> = pp.iter().map(|pp| pp.abs(5_000, SetPoint::new())).collect();
    let error = machine.finish(start_together(requests)).unwrap_err();
    assert!(matches!(error.failure(), Some(Failure::NotEnabled { .. })));
    assert_eq!(error.identity.axis, "axis1");
    assert!(!was_sent(&error), "{error}");
    machine.run(300);
    for station in &machine.stations {
        assert!(lock(&station.drive).ledger().is_empty());
    }
}

/// The cycle has looked at the first axis when the group is asked for, and the second one refuses at once.
#[test]
fn none_waits_for_ever_when_one_is_refused_before_the_others_are_taken() {
    let (mut machine, pp) = machine(2);
    machine.finish(pp[1].axis().disable()).unwrap();
    let requests: Vec<_> = pp.iter().map(|pp| pp.abs(5_000, SetPoint::new())).collect();
    let mut together = Task::new(start_together(requests));
    machine.cycle_between(1, || assert!(together.poll().is_none()));
    let error = machine.finish_task(&mut together).unwrap_err();
    assert!(matches!(error.failure(), Some(Failure::NotEnabled { .. })));
    assert!(!was_sent(&error), "{error}");
    // The axis that was not refused is free for the next move.
    let next = pp[0].move_abs(100, SetPoint::new());
    assert!(machine.finish(next).is_ok());
    assert_eq!(rises(&machine, 0).len(), 1);
}

#[test]
fn none_starts_when_one_would_end_beyond_a_limit() {
    let mut variant = Variant {
        limits: Limits {
            software: Some(PositionRange {
                min: -1_000,
                max: 1_000,
            }),
            ..Limits::trust_drive()
        },
        ..Variant::default()
    };
    variant.traits.relative_base = RelativeBase::Demand;
    let (mut machine, pp) = machine_of(2, &variant);
    let beyond = [
        pp[1].abs(1_001, SetPoint::new()),
        // By more than the axis rests beside 0.
        pp[1].rel(1_011, SetPoint::new()),
    ];
    for request in beyond {
        let requests = [pp[0].abs(500, SetPoint::new()), request];
        let error = machine.finish(start_together(requests)).unwrap_err();
        assert!(matches!(
            error.failure(),
            Some(Failure::BeyondLimit { asked: 1_001.., .. })
        ));
        assert!(!was_sent(&error), "{error}");
        machine.run(300);
        for station in &machine.stations {
            assert!(lock(&station.drive).ledger().is_empty());
        }
    }
    let requests = [
        pp[0].abs(500, SetPoint::new()),
        pp[1].rel(989, SetPoint::new()),
    ];
    assert!(machine.finish(start_together(requests)).is_ok());
}

/// Where the parameters go by SDO: whether the second axis refuses, or its numbers cannot be scaled, the first one's are as before.
#[test]
fn a_group_that_is_refused_has_written_no_parameters_of_any_axis() {
    let limits = Limits {
        software: Some(PositionRange {
            min: -1_000,
            max: 5_000,
        }),
        ..Limits::trust_drive()
    };
    let (mut machine, mut pp) = machine_of(
        2,
        &Variant {
            limits,
            ..Variant::by_sdo()
        },
    );
    let written = |machine: &Machine| machine.stations[0].sdo.written.lock().unwrap().len();
    let fast = SetPoint::new().velocity(7_777);
    let beyond = [pp[0].abs(10, fast), pp[1].abs(5_001, fast)];
    let error = machine.finish(start_together(beyond)).unwrap_err();
    assert!(matches!(error.failure(), Some(Failure::BeyondLimit { .. })));
    assert_eq!(written(&machine), 0, "{error}");

    let mm = Scale::counts_per_unit(Ratio::new(1_000, 1).unwrap());
    let scaled = pp[1].axis().scaled::<Mm>(mm).unwrap();
    machine.finish(pp.remove(1).release()).unwrap();
    let on_scaled = machine.finish(scaled.profile_position()).unwrap();
    let no_number = (
        pp[0].abs(10, fast),
        on_scaled.abs(f64::NAN, SetPoint::new()),
    );
    let error = machine.finish(start_together(no_number)).unwrap_err();
    assert!(matches!(error.kind, AxisErrorKind::Scale(_)), "{error}");
    assert_eq!(written(&machine), 0, "{error}");

    let within = (pp[0].abs(10, fast), on_scaled.abs(5.0, SetPoint::new()));
    let _moves = machine.finish(start_together(within)).unwrap();
    assert_eq!(written(&machine), 1);
}

#[test]
fn none_starts_when_one_is_stopped_before_the_frame() {
    for cycles in 0..6 {
        let (mut machine, pp) = machine(2);
        let requests: Vec<_> = pp.iter().map(|pp| pp.abs(5_000, SetPoint::new())).collect();
        let mut starting = Task::new(start_together(requests));
        assert!(starting.poll().is_none());
        machine.run(cycles);
        let rose = [0, 1].map(|n| rises(&machine, n).len());
        assert_eq!(rose[0], rose[1], "all or none");
        pp[1].axis().stop_handle().halt();
        machine.run(300);
        let rose_later = [0, 1].map(|n| rises(&machine, n).len());
        assert_eq!(rose_later, rose, "nothing starts after the halt");
        if rose == [0, 0] {
            let error = starting.poll().unwrap().unwrap_err();
            assert_eq!(
                error.failure(),
                Some(Failure::Halted {
                    delivery: Delivery::NotSent
                })
            );
            assert_eq!(error.identity.axis, "axis1");
        }
    }
}

#[test]
fn none_starts_when_the_future_is_dropped_before_the_frame() {
    let (mut machine, pp) = machine(2);
    let requests: Vec<_> = pp.iter().map(|pp| pp.abs(5_000, SetPoint::new())).collect();
    let mut starting = Task::new(start_together(requests));
    assert!(starting.poll().is_none());
    drop(starting);
    machine.run(300);
    assert!(rises(&machine, 0).is_empty() && rises(&machine, 1).is_empty());
    // Nothing of it is left in the way.
    let moved = machine.finish(pp[0].move_abs(5, SetPoint::new())).unwrap();
    machine.finish(moved.done()).unwrap();
}

/// One of them waits for the drive of another axis. Its axis is somebody else's by then, or nobody's.
#[test]
fn none_starts_once_the_lease_of_one_is_given_back() {
    for leased_again in [false, true] {
        let (mut machine, mut pp) = machine(2);
        let y = pp.remove(1);
        let x = pp.remove(0);
        // A third one waits until the first is over.
        let slow = SetPoint::new()
            .velocity(20_000)
            .buffer_mode(BufferMode::Buffered);
        for target in [10_000, 15_000] {
            let _on_its_way = machine.finish(y.move_abs(target, slow)).unwrap();
        }
        let requests = [x.abs(5_000, SetPoint::new()), y.abs(0, slow)];
        let mut together = Task::new(start_together(requests));
        assert!(together.poll().is_none());
        machine.run(50);
        assert!(rises(&machine, 0).is_empty(), "it waits for the other axis");

        let axis = x.axis().clone();
        drop(x);
        let again = leased_again.then(|| machine.finish(axis.profile_position()).unwrap());
        machine.run(3_000);
        assert!(rises(&machine, 0).is_empty(), "nobody has asked for this");
        assert_eq!(rises(&machine, 1).len(), 2);
        let error = together.poll().unwrap().unwrap_err();
        let is_told = match error.kind {
            AxisErrorKind::ModeInUse => leased_again,
            AxisErrorKind::NotLeased => !leased_again,
            _ => false,
        };
        assert!(is_told, "{error}");
        assert_eq!(error.identity.axis, "axis0");
        drop(again);
        // Nothing of it is left in the way.
        let x = machine.finish(axis.profile_position()).unwrap();
        let requests = [x.abs(5_000, SetPoint::new()), y.abs(0, slow)];
        let moves = machine.finish(start_together(requests)).unwrap();
        for moved in &moves {
            machine.finish(moved.done()).unwrap();
        }
    }
}

#[test]
fn a_drive_that_does_not_acknowledge_is_told_with_the_moves_that_run() {
    let (mut machine, pp) = machine(2);
    lock(&machine.stations[1].drive).disturbances().ack = servocrab_sim::ds402::AckFault::Never;
    let requests: Vec<_> = pp.iter().map(|pp| pp.abs(9_000, SetPoint::new())).collect();
    let error = machine.finish(start_together(requests)).unwrap_err();
    assert!(matches!(
        error.failure(),
        Some(Failure::Unknown {
            doubt: Doubt::Unacknowledged,
            ..
        })
    ));
    assert_eq!(error.identity.axis, "axis1");
    assert!(
        matches!(&error.kind, AxisErrorKind::NotAllStarted { started, .. } if **started == ["axis0"]),
        "{error}"
    );
    let text = error.clone().to_string();
    assert!(
        text.ends_with("acknowledged, and under way, are those of axis0"),
        "{text}"
    );
    machine.run(2_000);
    let off = lock(&machine.stations[0].drive).position() - 9_000;
    assert!(off.abs() <= 10, "it goes on: {off}");
}

#[test]
fn moves_of_one_axis_or_of_two_networks_are_not_started_together() {
    let (mut first, pp) = machine(1);
    let (_second, other) = machine(1);
    let at = |pp: &ProfilePosition| pp.abs(5, SetPoint::new());
    let twice = first
        .finish(start_together([at(&pp[0]), at(&pp[0])]))
        .unwrap_err();
    assert!(matches!(twice.kind, AxisErrorKind::NotTogether));
    let apart = first
        .finish(start_together([at(&pp[0]), at(&other[0])]))
        .unwrap_err();
    assert!(matches!(apart.kind, AxisErrorKind::NotTogether));
    assert!(
        first
            .finish(start_together(Vec::<MoveRequest>::new()))
            .unwrap()
            .is_empty()
    );
}

/// Whoever waits for the parameters of a move is woken when a group is submitted, and a waker is code of the program: this one waits for
/// a thread that asks for another group.
#[test]
fn a_waker_may_wait_for_a_group_while_another_is_submitted() {
    struct Asks {
        on: ProfilePosition,
        /// Groups that were asked for, and those that did not return.
        asked: AtomicUsize,
        waiting: AtomicUsize,
    }

    impl Wake for Asks {
        fn wake(self: Arc<Self>) {
            let (returns, returned) = mpsc::channel();
            let this = Arc::clone(&self);
            std::thread::spawn(move || {
                let group = start_together([this.on.abs(500, SetPoint::new())]);
                let _ = pin!(group).poll(&mut Context::from_waker(Waker::noop()));
                returns.send(())
            });
            // It comes at once, or never.
            if returned.recv_timeout(Duration::from_secs(10)).is_err() {
                self.waiting.fetch_add(1, Ordering::Relaxed);
            }
            self.asked.fetch_add(1, Ordering::Relaxed);
        }
    }

    let variant = Variant {
        not_mapped: vec![0x6081],
        ..Variant::default()
    };
    let (mut machine, mut pp) = machine_of(3, &variant);
    let asks = Arc::new(Asks {
        on: pp.remove(2),
        asked: AtomicUsize::new(0),
        waiting: AtomicUsize::new(0),
    });
    let waker = Waker::from(Arc::clone(&asks));
    let fast = |velocity| SetPoint::new().velocity(velocity);
    let mut group = Task::new(start_together([
        pp[0].abs(5_000, fast(10_000)),
        pp[1].abs(5_000, fast(10_000)),
    ]));
    let mut behind = pin!(pp[0].move_abs(6_000, fast(20_000)));
    // It waits for the second axis with the parameters of the first.
    let slow = &machine.stations[1].sdo.slow_writes;
    slow.store(true, Ordering::Relaxed);
    let mut started = None;
    for _ in 0..200 {
        started = started.or_else(|| group.poll());
        let mut context = Context::from_waker(&waker);
        if behind.as_mut().poll(&mut context).is_ready() {
            break;
        }
        machine.cycle();
    }
    assert!(started.is_some_and(|started| started.is_ok()));
    assert_ne!(asks.asked.load(Ordering::Relaxed), 0);
    assert_eq!(asks.waiting.load(Ordering::Relaxed), 0);
}
