//! The time of the cycles, and a network that several tasks share.

use std::{sync::Arc, thread, time::Duration};

use servocrab::{Network, NetworkError, link::Wire};
use servocrab_sim::{AlState, Segment, personality};
use smol::future::poll_once;

use crate::rig::{Line, Rig, akd2g, unhomed};

fn start() -> Rig {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let builder = Network::builder().link(line.wire());
    Rig::start(builder.drive(0, akd2g())).unwrap()
}

fn in_real_time(line: &Line) -> Wire {
    let line = line.clone();
    Wire::new(move |frame, now| line.segment().process(frame, now))
}

#[test]
fn a_pause_lasts_until_the_first_cycle_that_ends_after_it() {
    let mut rig = start();
    let clock = rig.net().clock();
    let before = clock.now();
    rig.until(clock.sleep(Duration::from_secs(2))).unwrap();
    let took = clock.now() - before;
    let cycle = Duration::from_millis(1);
    let wanted = Duration::from_secs(2);
    assert!(took >= wanted && took < wanted + 2 * cycle, "{took:?}");
}

/// By the network's time, which passes in an instant here.
#[test]
fn a_wait_ends_when_its_time_is_over_and_not_before() {
    let mut rig = start();
    let clock = rig.net().clock();
    let limit = Duration::from_secs(2);
    let before = clock.now();
    let never = clock.timeout(limit, core::future::pending::<()>());
    assert_eq!(rig.until(never).unwrap(), None);
    let took = clock.now() - before;
    assert!(
        took >= limit && took < limit + Duration::from_millis(2),
        "{took:?}"
    );

    let pause = clock.sleep(limit - Duration::from_millis(5));
    let done = rig.until(clock.timeout(limit, pause)).unwrap();
    assert!(matches!(done, Some(Ok(()))), "{done:?}");
}

#[test]
fn all_axes_and_drives_are_there_and_all_faults_are_reset_at_once() {
    let line = Line::new(
        Segment::new()
            .with(personality::akd2g())
            .with(personality::generic()),
    );
    let drive = unhomed(servocrab::drives::generic(), &["z"]);
    let builder = Network::builder().link(line.wire());
    let mut rig = Rig::start(builder.drive(0, akd2g()).drive(1, drive)).unwrap();
    let names: Vec<_> = rig
        .net()
        .axes()
        .map(|axis| axis.identity().axis.clone())
        .collect();
    assert_eq!(names, ["x", "y", "z"]);
    let positions: Vec<_> = rig.net().drives().map(|drive| drive.position).collect();
    assert_eq!(positions, [0, 1]);

    // Of one axis the cause stays: the faults of the others are reset all the same, and that is told.
    line.segment().axis_mut(0, 0).unwrap().inject_fault(0x7500);
    line.segment()
        .axis_mut(0, 1)
        .unwrap()
        .inject_lasting_fault(0x7305);
    line.segment().axis_mut(1, 0).unwrap().inject_fault(0x7500);
    rig.run_for(Duration::from_millis(50));
    let net = rig.net.take().unwrap();
    let error = rig.until(net.reset_faults()).unwrap_err();
    assert_eq!(error.identity.axis, "y");
    let is_fault = |net: &Network| {
        net.axes()
            .map(|axis| axis.status().state.is_fault())
            .collect::<Vec<_>>()
    };
    assert_eq!(is_fault(&net), [false, true, false]);
    line.segment().axis_mut(0, 1).unwrap().clear_cause();
    rig.until(net.reset_faults()).unwrap();
    assert_eq!(is_fault(&net), [false; 3]);
    // There is none any more.
    rig.until(net.reset_faults()).unwrap();
    rig.net = Some(net);
    rig.shutdown();
}

#[test]
fn every_cycle_is_told_once_with_what_it_brought() {
    let mut rig = start();
    let (clock, axis) = (rig.net().clock(), rig.net().axis("x").unwrap());
    let seen = rig.until(async {
        let mut seen = Vec::new();
        for _ in 0..50 {
            let at = clock.next_cycle().await.unwrap();
            seen.push((at, axis.status().cycle));
        }
        seen
    });
    for pair in seen.windows(2) {
        assert!(pair[1].0 > pair[0].0);
        assert_eq!(pair[1].1, pair[0].1 + 1, "{seen:?}");
    }
}

#[test]
fn whoever_waits_for_a_cycle_is_told_that_the_network_has_ended() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let net = Network::builder()
        .link(in_real_time(&line))
        .drive(0, akd2g());
    let net = smol::block_on(net.start()).unwrap();
    let clock = net.clock();
    let waits = thread::spawn(move || smol::block_on(clock.sleep(Duration::MAX)));
    let clock = net.clock();
    smol::block_on(net.shutdown()).unwrap();
    let told = waits.join().unwrap();
    assert!(matches!(told, Err(NetworkError::Thread(_))), "{told:?}");
    let told = smol::block_on(clock.next_cycle());
    assert!(matches!(told, Err(NetworkError::Thread(_))), "{told:?}");
}

#[test]
fn a_network_that_others_hold_can_be_ended() {
    let line = Line::new(Segment::new().with(personality::generic()));
    let drive = unhomed(servocrab::drives::generic(), &["x"]);
    let net = Network::builder().link(in_real_time(&line)).drive(0, drive);
    let net = Arc::new(smol::block_on(net.start()).unwrap());
    let x = net.axis("x").unwrap();
    smol::block_on(x.enable()).unwrap();
    let (panel, events, emergencies) = (Arc::clone(&net), net.events(), net.all_emergencies());
    smol::block_on(net.shutdown()).unwrap();
    let segment = line.segment();
    assert!(!segment.axis(0, 0).unwrap().state().is_powered());
    assert_eq!(segment.device(0).unwrap().al_state(), AlState::Init);
    drop(segment);
    let error = smol::block_on(x.enable()).unwrap_err();
    assert!(
        error.to_string().ends_with("the network is closed"),
        "{error}"
    );
    let end = |told: Option<bool>| told == Some(false);
    assert!(end(smol::block_on(poll_once(async {
        events.next().await.is_some()
    }))));
    assert!(end(smol::block_on(poll_once(async {
        emergencies.next().await.is_some()
    }))));
    // Once more is no mistake.
    smol::block_on(panel.shutdown()).unwrap();
}
