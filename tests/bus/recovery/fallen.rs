//! Drives that have left OP and kept their power.

use std::{
    future::{Future, poll_fn},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    task::Poll,
    time::Duration,
};

use servocrab::{
    AxisConfig, DriveConfig, Failure, Network, Referencing, SetPoint,
    axis::Delivery,
    bus::{AlState as State, AlStatus, NetworkEvent, Recovered},
    coe::ObjectAddress,
    drives::{self, DriveDescription},
    link::Fate,
    profile_position::HomedSignal,
};
use servocrab_sim::{AlState, Device, Habits, personality};

use super::{MIDDLE, MS, Yard, events, fall, is_over, kinds, unhomed, with_parameters_by_sdo};
use crate::rig::is_cyclic;

const FALLEN: AlStatus = AlStatus {
    state: State::SafeOp,
    error: Some(0x001B),
};

#[test]
fn a_drive_that_fell_while_its_axes_moved_is_led_back_and_nothing_moves_by_it() {
    for (device, description, axes) in kinds() {
        let name = description.name.clone();
        let mut yard = Yard::new(device, unhomed(description, axes));
        let moves: Vec<_> = axes.iter().map(|axis| yard.start(axis)).collect();
        yard.falls(0x001B);
        let told = events(&yard.rig);
        assert!(
            told.iter().any(|event| matches!(event,
                NetworkEvent::LeftOp { drive, status } if drive.position == 1 && *status == FALLEN)),
            "{name}: {told:?}"
        );
        let mut modes = Vec::new();
        for (mode, motion) in moves {
            let outcome = yard.rig.until(motion.done());
            assert!(is_over(&outcome), "{name}: {outcome:?}");
            modes.push(mode);
        }
        yard.nothing_may_happen();
        let recovered = yard.recover(1).unwrap();
        assert_eq!(recovered, Recovered::FromSafeOp { from: FALLEN }, "{name}");
        assert_eq!(yard.state(MIDDLE), AlState::Op);
        yard.nothing_has_happened();
        assert!(
            events(&yard.rig)
                .iter()
                .any(|event| matches!(event, NetworkEvent::InOp(drive) if drive.position == 1)),
            "{name}"
        );
        // The mode was leased all the while.
        drop(modes);
        for axis in axes {
            yard.works_again(axis);
        }
        yard.ends();
    }
}

#[test]
fn to_a_drive_that_is_in_op_nothing_is_done() {
    let mut yard = Yard::new(personality::generic(), unhomed(drives::generic(), &["z"]));
    let (mode, motion) = yard.start("z");
    assert_eq!(yard.recover(1).unwrap(), Recovered::WasInOp);
    assert_eq!(yard.recover(0).unwrap(), Recovered::WasInOp);
    yard.rig.run_for(100 * MS);
    let velocity = yard.axis("z").status().velocity;
    assert!((velocity - 10_000).abs() < 1_000, "it moves on");
    assert!(
        yard.recover(7)
            .unwrap_err()
            .to_string()
            .contains("position 7")
    );
    drop((mode, motion));
    yard.ends();
}

#[test]
fn what_was_homed_is_still_where_it_was() {
    is_still_homed(personality::akd2g(), drives::akd2g());
}

#[test]
fn what_was_homed_is_still_where_it_was_though_no_object_of_the_drive_says_so() {
    is_still_homed(personality::generic(), drives::generic());
}

fn is_still_homed(device: Device, description: DriveDescription) {
    let drive =
        DriveConfig::new(description).axis(AxisConfig::new("z").referencing(Referencing::ByHoming));
    let mut yard = Yard::new(device, drive);
    let z = yard.is_homed_here("z", 700);
    yard.falls(0x001B);
    assert!(!z.status().referenced, "as long as nobody has looked");
    yard.nothing_may_happen();
    yard.recover(1).unwrap();
    yard.nothing_has_happened();
    assert!(z.status().referenced);
    let position = z.status().position;
    assert!((position - 700).abs() <= 10, "{position}");
    yard.ends();
}

#[test]
fn a_drive_that_falls_again_on_the_way_says_why_and_can_be_led_back_later() {
    let mut yard = Yard::new(personality::akd2g(), unhomed(drives::akd2g(), &["z", "w"]));
    let (mode, motion) = yard.start("z");
    yard.falls(0x001B);
    assert!(is_over(&yard.rig.until(motion.done())));
    let habits = |falls| Habits {
        falls,
        ..Habits::default()
    };
    let set = |yard: &Yard, falls| {
        let mut segment = yard.line.segment();
        segment
            .device_mut(MIDDLE)
            .unwrap()
            .set_habits(habits(falls));
    };
    set(&yard, Some((AlState::Op, AlState::SafeOp, 0x8001)));
    yard.nothing_may_happen();
    let error = yard.recover(1).unwrap_err().to_string();
    for part in ["drive 1", "bringing it into OP", "SAFEOP", "8001h"] {
        assert!(error.contains(part), "{part} is not in: {error}");
    }
    yard.nothing_has_happened();
    assert_eq!(yard.state(MIDDLE), AlState::SafeOp);
    assert!(yard.axis("z").status().lost);
    set(&yard, None);
    yard.nothing_may_happen();
    let recovered = yard.recover(1).unwrap();
    assert!(
        matches!(recovered, Recovered::FromSafeOp { .. }),
        "{recovered}"
    );
    yard.nothing_has_happened();
    drop(mode);
    yard.works_again("z");
    yard.ends();
}

#[test]
fn an_axis_that_was_halted_or_stopped_is_neither_afterwards_and_what_was_asked_for_meanwhile_is_refused()
 {
    let mut yard = Yard::new(personality::akd2g(), unhomed(drives::akd2g(), &["z", "w"]));
    let (z_mode, z_motion) = yard.start("z");
    let (z, w) = (yard.axis("z"), yard.axis("w"));
    yard.rig.until(z.halt()).unwrap();
    yard.rig.until(w.enable()).unwrap();
    yard.falls(0x001B);
    assert!(is_over(&yard.rig.until(z_motion.done())));
    let refused = yard.rig.until(z_mode.move_abs(0, super::set_point()));
    let failure = refused.unwrap_err();
    assert!(
        matches!(
            failure.failure(),
            Some(Failure::LeftOp { code: 0x001B, .. })
        ),
        "{failure}"
    );
    yard.nothing_may_happen();
    yard.recover(1).unwrap();
    yard.nothing_has_happened();
    drop(z_mode);
    yard.works_again("z");
    yard.works_again("w");
    yard.ends();
}

#[test]
fn a_move_that_was_still_writing_its_parameters_when_its_drive_fell_does_not_start_after_all() {
    // It writes 6081h before bit 4 rises.
    let (drive, description) = with_parameters_by_sdo();
    let mut yard = Yard::new(drive, unhomed(description, &["z"]));
    let z = yard.axis("z");
    let mode = yard.rig.until(async {
        z.enable().await.unwrap();
        z.profile_position().await.unwrap()
    });
    let line = yard.line.clone();
    let taken = move || line.segment().device(MIDDLE).unwrap().messages_taken();
    let before = taken();
    // Each of its answers takes half a second.
    let mut segment = yard.line.segment();
    segment
        .device_mut(MIDDLE)
        .unwrap()
        .set_mailbox_delay(500 * MS);
    drop(segment);
    let net = yard.rig.net.take().unwrap();
    let line = yard.line.clone();
    let set_point = SetPoint::new().velocity(5_000);
    let mut moving = Box::pin(mode.move_abs(9_000, set_point));
    yard.rig.until(poll_fn(|cx| {
        assert!(moving.as_mut().poll(cx).is_pending());
        if taken() > before {
            Poll::Ready(())
        } else {
            Poll::Pending
        }
    }));
    // The program does not come back to it before the axis is enabled again.
    fall(&line, 0x001B);
    yard.rig.until(async {
        net.recover(1).await.unwrap();
        z.enable().await.unwrap();
    });
    let moved = yard.rig.until(moving);
    yard.rig.net = Some(net);
    let refused = moved.unwrap_err();
    assert!(
        matches!(
            refused.failure(),
            Some(Failure::BusLost {
                delivery: Delivery::NotSent
            })
        ),
        "{refused}"
    );
    assert!(
        yard.line
            .segment()
            .axis(MIDDLE, 0)
            .unwrap()
            .ledger()
            .is_empty()
    );
    drop(mode);
    yard.ends();
}

#[test]
fn an_axis_that_its_drive_did_not_stop_is_stopped_on_the_way_back_and_does_not_move_on() {
    let mut yard = Yard::new(personality::generic(), unhomed(drives::generic(), &["z"]));
    let (mode, motion) = yard.start("z");
    let mut segment = yard.line.segment();
    // Somebody has told it to do nothing when it loses its connection.
    let axis = segment.axis_mut(MIDDLE, 0).unwrap();
    axis.set(0x6007, 0, 0).unwrap();
    segment.device_mut(MIDDLE).unwrap().fall_to_safe_op(0x001B);
    drop(segment);
    yard.rig.run_for(300 * MS);
    let z = yard.axis("z");
    assert!((z.status().velocity - 10_000).abs() < 1_000, "it moves on");
    assert!(is_over(&yard.rig.until(motion.done())));
    yard.recover(1).unwrap();
    yard.rig.run_for(300 * MS);
    assert!(z.status().velocity.abs() < 1_000);
    yard.nothing_may_happen();
    yard.nothing_has_happened();
    drop(mode);
    yard.works_again("z");
    yard.ends();
}

/// It has kept its power, and lost its encoder.
#[test]
fn what_was_homed_is_not_known_any_more_where_the_drive_says_so() {
    let shown = ObjectAddress::new(0x6085, 0);
    let mut description = drives::generic();
    description.traits.homed = Some(HomedSignal {
        object: shown,
        set: 1,
        clear: 0,
    });
    let drive =
        DriveConfig::new(description).axis(AxisConfig::new("z").referencing(Referencing::ByHoming));
    let mut yard = Yard::new(personality::generic(), drive);
    let shows = |yard: &Yard, value| {
        let mut segment = yard.line.segment();
        let axis = segment.axis_mut(MIDDLE, 0).unwrap();
        axis.set(shown.index, shown.subindex, value).unwrap();
    };
    shows(&yard, 100_000);
    let z = yard.is_homed_here("z", 700);
    shows(&yard, 100_001);
    yard.falls(0x001B);
    yard.recover(1).unwrap();
    yard.rig.run_for(2 * MS);
    assert!(z.status().referenced, "the drive says so");
    shows(&yard, 100_000);
    yard.falls(0x001B);
    yard.recover(1).unwrap();
    yard.rig.run_for(2 * MS);
    assert!(!z.status().referenced, "the drive says that it is not");
    yard.ends();
}

/// A yard in which frames without process data take so long, as long as that is set.
fn with_slow_requests(delay: Duration) -> (Arc<AtomicBool>, Yard) {
    let slow = Arc::new(AtomicBool::new(false));
    let is_slow = Arc::clone(&slow);
    let drive = unhomed(drives::generic(), &["z"]);
    let yard = Yard::with(personality::generic(), drive, move |line| {
        let wire = line.wire_with(move |_, frame| {
            if is_slow.load(Ordering::Relaxed) && !is_cyclic(frame) {
                Fate::Delay(delay)
            } else {
                Fate::Deliver
            }
        });
        Network::builder().link(wire)
    });
    (slow, yard)
}

/// Another task enables the axis as soon as it is there, and the recovery looks a moment later.
#[test]
fn an_axis_that_is_enabled_as_soon_as_it_is_back_does_not_fall_again() {
    let cases = [9, 10, 14].map(|delay| (0..6).map(move |offset| (delay, offset)));
    for (delay, offset) in cases.into_iter().flatten() {
        let (slow, mut yard) = with_slow_requests(delay * MS);
        let z = yard.axis("z");
        yard.falls(0x001B);
        yard.rig.run_for(offset * 2 * MS);
        slow.store(true, Ordering::Relaxed);
        let net = yard.rig.net.take().unwrap();
        let recovery = async { net.recover(1).await };
        let enabling = async {
            while z.status().lost {
                z.changed().await.unwrap();
            }
            z.enable().await
        };
        let (recovered, enabled) = yard.rig.until(smol::future::zip(recovery, enabling));
        slow.store(false, Ordering::Relaxed);
        yard.rig.net = Some(net);
        yard.rig.run_for(100 * MS);
        let state = yard.state(MIDDLE);
        assert!(
            recovered.is_ok() && enabled.is_ok() && state == AlState::Op,
            "{delay}, {offset}: {recovered:?}, {enabled:?}, {state:?}"
        );
        drop(z);
        yard.ends();
    }
}

/// It is about to be asked to leave OP again.
#[test]
fn no_axis_is_enabled_whose_recovery_was_dropped_when_it_was_back() {
    let (slow, mut yard) = with_slow_requests(9 * MS);
    let z = yard.axis("z");
    yard.falls(0x001B);
    slow.store(true, Ordering::Relaxed);
    let net = yard.rig.net.take().unwrap();
    let dropped = yard.rig.until(async {
        let recovery = async { Some(net.recover(1).await) };
        let back = async {
            while z.status().lost {
                z.changed().await.unwrap();
            }
            None
        };
        smol::future::or(back, recovery).await
    });
    assert!(dropped.is_none(), "{dropped:?}");
    let enabled = yard.rig.until(z.enable());
    slow.store(false, Ordering::Relaxed);
    yard.rig.net = Some(net);
    yard.rig.run_for(200 * MS);
    assert_eq!(yard.state(MIDDLE), AlState::SafeOp);
    assert!(enabled.is_err(), "{enabled:?}");
    yard.recover(1).unwrap();
    yard.works_again("z");
    drop(z);
    yard.ends();
}
