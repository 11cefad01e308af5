//! What the bus thread tells of its cycles: counters, histograms, black boxes, the ports' error counters.

use std::time::Duration;

use servocrab::{
    Network, NetworkError, SetPoint,
    bus::{Answered, AxisIncident, NetworkEvent, PortErrors},
    ds402::State,
    link::Fate,
};
use servocrab_sim::{Segment, personality};

use crate::rig::{Line, Rig, akd2g, is_cyclic};

const MS: Duration = Duration::from_millis(1);
/// Out and back on the rig's wire.
const ROUND_TRIP: Duration = Duration::from_micros(10);

fn two_drives() -> Line {
    Line::new(
        Segment::new()
            .with(personality::coupler())
            .with(personality::akd2g()),
    )
}

fn start(line: &Line) -> Rig {
    Rig::start(Network::builder().link(line.wire()).drive(1, akd2g())).unwrap()
}

fn run(rig: &mut Rig, cycles: u32) {
    let until = rig.bus.now() + MS * cycles;
    while rig.bus.now() < until {
        assert!(rig.bus.turn());
    }
}

#[test]
fn the_histograms_hold_one_time_for_each_cycle() {
    let line = two_drives();
    let mut rig = start(&line);
    let before = rig.net().timing();
    run(&mut rig, 500);
    let timing = rig.net().timing();
    let counted = rig.net().statistics();
    let since = timing.lateness.since(&before.lateness);
    assert!((499..=501).contains(&since.count()), "{}", since.count());
    assert_eq!(timing.lateness.count(), counted.cycles);
    assert_eq!(counted.overruns, 0);
    // In virtual time nothing is late but what waits for a frame that is on its way.
    assert!(since.most().unwrap() <= ROUND_TRIP, "{:?}", since.most());
    let trips = timing.round_trip.since(&before.round_trip);
    assert!((499..=501).contains(&trips.count()), "{}", trips.count());
    assert_eq!(timing.round_trip.least(), Some(ROUND_TRIP));
    assert_eq!(timing.round_trip.most(), Some(ROUND_TRIP));
    rig.shutdown();
}

#[test]
fn a_cycle_whose_frame_is_lost_has_no_round_trip_and_is_counted_for_its_drive() {
    let line = two_drives();
    let mut cyclic = 0;
    let wire = line.wire_with(move |_, frame| {
        cyclic += u32::from(is_cyclic(frame));
        if is_cyclic(frame) && cyclic > 200 && cyclic % 10 == 0 {
            Fate::LoseAnswer
        } else {
            Fate::Deliver
        }
    });
    let mut rig = Rig::start(Network::builder().link(wire).drive(1, akd2g())).unwrap();
    run(&mut rig, 200);
    let (before, drive) = (rig.net().statistics(), rig.net().drive_statistics());
    run(&mut rig, 200);
    let (after, timing) = (rig.net().statistics(), rig.net().timing());
    let lost = after.lost - before.lost;
    assert!((19..=21).contains(&lost), "{lost}");
    let [told] = &rig.net().drive_statistics()[..] else {
        panic!("one drive was declared");
    };
    assert_eq!(told.drive.position, 1);
    assert_eq!(told.stale_cycles - drive[0].stale_cycles, lost);
    assert_eq!(told.undelivered_cycles, drive[0].undelivered_cycles);
    // The last cycle may be under way.
    let complete = after.cycles - after.lost;
    assert!(complete.abs_diff(timing.round_trip.count()) <= 1);
    rig.shutdown();
}

#[test]
fn a_black_box_holds_the_move_as_it_went_over_the_wire() {
    let line = two_drives();
    let mut rig = start(&line);
    let axis = rig.net().axis("x").unwrap();
    rig.until(axis.enable()).unwrap();
    rig.until(async {
        let mode = axis.profile_position().await.unwrap();
        let set_point = SetPoint::new()
            .velocity(100_000)
            .acceleration(10_000_000)
            .deceleration(10_000_000);
        let motion = mode.move_abs(5_000, set_point).await.unwrap();
        motion.done().await.unwrap();
    });
    let mut net = rig.net.take().unwrap();
    let black_box = crate::rig::turn_until(&mut rig.bus, net.black_box("x")).unwrap();
    assert_eq!(black_box.axis.axis, "x");
    assert_eq!(black_box.incident, None);
    assert!(black_box.cycles.len() > 50);
    // One cycle after the other, each millisecond.
    for pair in black_box.cycles.windows(2) {
        assert_eq!(pair[1].number, pair[0].number + 1);
        // The first begins as soon as it can.
        assert!(
            pair[0].number == 1 || pair[1].time - pair[0].time == MS,
            "{pair:?}"
        );
    }
    let rise = black_box
        .cycles
        .iter()
        .find(|cycle| cycle.controlword.bits() & 0x10 != 0)
        .expect("bit 4 has risen");
    assert_eq!((rise.answered, rise.target), (Answered::Delivered, 5_000));
    let last = black_box.cycles.last().unwrap().inputs.unwrap();
    assert_eq!(last.state(), State::OperationEnabled);
    let held = line.segment().axis(1, 0).unwrap().position();
    assert!((i64::from(last.position) - held).abs() < 20);
    // Of the other axis of the drive, which did not move.
    let other = crate::rig::turn_until(&mut rig.bus, net.black_box("y")).unwrap();
    assert!(
        other
            .cycles
            .iter()
            .all(|cycle| cycle.controlword.bits() & 0x10 == 0)
    );
    let missing = crate::rig::turn_until(&mut rig.bus, net.black_box("z"));
    assert!(matches!(missing, Err(NetworkError::Declaration(_))));
    // More cycles than are kept: the last thousand.
    rig.net = Some(net);
    run(&mut rig, 1_500);
    net = rig.net.take().unwrap();
    let black_box = crate::rig::turn_until(&mut rig.bus, net.black_box("x")).unwrap();
    assert_eq!(black_box.cycles.len(), 1_000);
    // Up to the one that was over last.
    let cycles = net.statistics().cycles;
    assert_eq!(black_box.cycles.last().unwrap().number, cycles);
    rig.net = Some(net);
    rig.shutdown();
}

#[test]
fn a_fault_comes_with_the_cycles_that_led_to_it() {
    let line = two_drives();
    let mut rig = start(&line);
    let events = rig.net().events();
    let axis = rig.net().axis("x").unwrap();
    rig.until(axis.enable()).unwrap();
    run(&mut rig, 50);
    line.segment().axis_mut(1, 0).unwrap().inject_fault(0x8611);
    let event = rig.until(events.next()).unwrap();
    let NetworkEvent::AxisIncident(black_box) = &event else {
        panic!("{event}");
    };
    assert_eq!(black_box.axis.axis, "x");
    assert_eq!(black_box.incident, Some(AxisIncident::Fault));
    let states: Vec<_> = black_box
        .cycles
        .iter()
        .filter_map(|cycle| Some(cycle.inputs?.state()))
        .collect();
    let fault = states.iter().position(|state| state.is_fault()).unwrap();
    assert!(fault > 40, "what led to it: {fault} cycles");
    assert_eq!(states[fault - 1], State::OperationEnabled);
    assert!(states[fault..].iter().all(|state| state.is_fault()));
    assert!(event.to_string().contains("axis x (drive 1"), "{event}");
    run(&mut rig, 50);
    assert!(events.try_next().is_none(), "told once");
    rig.shutdown();
}

#[test]
fn the_ports_tell_which_cable_damages_frames() {
    let line = two_drives();
    let mut rig = start(&line);
    let clean = rig.net.take().unwrap();
    let ports = crate::rig::turn_until(&mut rig.bus, clean.port_errors()).unwrap();
    assert_eq!(ports.len(), 2, "declared or not");
    assert!(
        ports
            .iter()
            .all(|device| device.ports.iter().all(PortErrors::is_clean))
    );
    rig.net = Some(clean);
    // The cable between coupler and drive.
    line.segment().damage_frames(1, 10);
    let before = rig.net().statistics();
    run(&mut rig, 100);
    line.segment().damage_frames(0, 0);
    let lost = rig.net().statistics().lost - before.lost;
    assert!((8..=12).contains(&lost), "{lost}");
    let net = rig.net.take().unwrap();
    let ports = crate::rig::turn_until(&mut rig.bus, net.port_errors()).unwrap();
    let [coupler, drive] = &ports[..] else {
        panic!("{ports:?}");
    };
    let found = drive.ports[0];
    assert!(
        u64::from(found.physical) >= lost && found.forwarded == 0,
        "{found:?}"
    );
    assert!(coupler.ports[0].is_clean());
    assert_eq!(coupler.ports[1].physical, 0, "{coupler:?}");
    assert_eq!(coupler.ports[1].forwarded, found.physical);
    rig.net = Some(net);
    // A cable that was pulled.
    line.segment().unplug(1);
    run(&mut rig, 20);
    line.segment().plug();
    run(&mut rig, 20);
    let net = rig.net.take().unwrap();
    let ports = crate::rig::turn_until(&mut rig.bus, net.port_errors()).unwrap();
    assert_eq!(ports[0].ports[1].lost_links, 1);
    rig.net = Some(net);
    rig.shutdown();
}

#[test]
fn what_is_asked_of_a_network_that_has_ended_is_an_error_and_no_wait_without_end() {
    let line = two_drives();
    let mut rig = start(&line);
    let net = rig.net.take().unwrap();
    let stop = net.black_box("x");
    let mut stop = std::pin::pin!(stop);
    // Asked, and the loop ends before it answers.
    assert!(smol::block_on(smol::future::poll_once(&mut stop)).is_none());
    drop(rig.bus);
    assert!(matches!(smol::block_on(stop), Err(NetworkError::Thread(_))));
    // Nobody takes the questions any more, and there is room for 16.
    for _ in 0..20 {
        let mut ports = std::pin::pin!(net.port_errors());
        let ports = smol::block_on(smol::future::poll_once(&mut ports));
        assert!(matches!(ports, Some(Err(NetworkError::Thread(_)))));
    }
}
