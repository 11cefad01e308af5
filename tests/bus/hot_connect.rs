//! Optional groups: tools that are put in and taken out while another axis moves.

use std::time::Duration;

use servocrab::{
    Failure, Network, NetworkError, Outcome, SetPoint,
    bus::{DevicePlace, Expected, NetworkBuilder, NetworkEvent},
    coe::{SdoError, obj},
    drives::{self, DriveDescription},
};
use servocrab_sim::{AlState, Device, Segment, ds402::State, personality, personality::Servo};

use crate::rig::{Line, Rig, akd2g, unhomed};

const MS: Duration = Duration::from_millis(1);
/// The alias of the tool, and of another one.
const DRILL: u16 = 7;
const SAW: u16 = 8;
/// Where a tool stands in the line, at port 3 of a coupler; the drive with axes `x` and `y` is behind it.
const TOOL: usize = 1;
const BEHIND: usize = 2;

fn tool(alias: u16) -> Device {
    Servo::pp2010().alias(alias).build()
}

/// The description of the tool's drive, and of no other kind.
fn description() -> DriveDescription {
    let device = personality::pp2010();
    let mut description = drives::pp2010();
    description.vendor = Some(device.description().identity.vendor);
    description.product = Some(device.description().identity.product);
    description
}

fn optional(builder: NetworkBuilder, name: &str, place: DevicePlace, axis: &str) -> NetworkBuilder {
    let drive = unhomed(description(), &[axis]);
    builder.optional(name, |group| group.drive(place, drive))
}

/// A machine with a coupler, to which tools are plugged, and a drive behind it.
struct Machine {
    line: Line,
    rig: Rig,
}

impl Machine {
    /// With this tool, plugged in or not.
    fn with(
        tool: Device,
        is_in: bool,
        declare: impl FnOnce(NetworkBuilder) -> NetworkBuilder,
    ) -> Self {
        let mut segment = Segment::new()
            .with(personality::coupler())
            .with(personality::akd2g());
        assert_eq!(segment.attach(0, 3, tool), Some(TOOL));
        if !is_in {
            segment.unplug(TOOL);
        }
        Self::of(segment, |builder| declare(builder.drive(1, akd2g())))
    }

    /// Of these devices, the first of which is a coupler.
    fn of(segment: Segment, declare: impl FnOnce(NetworkBuilder) -> NetworkBuilder) -> Self {
        let line = Line::ideal(segment);
        let builder = Network::builder().link(line.wire());
        let rig = Rig::start(declare(builder.expect(0, Expected::any()))).unwrap();
        Self { line, rig }
    }

    fn drill(tool: Device, is_in: bool) -> Self {
        Self::with(tool, is_in, |builder| {
            optional(builder, "drill", DevicePlace::Alias(DRILL), "z")
        })
    }

    fn plug_in(&mut self) {
        self.line.segment().plug_in(TOOL);
    }

    fn unplug(&mut self) {
        self.line.segment().unplug(TOOL);
    }

    /// Waits until the group is there, and takes what was told.
    fn joins(&mut self, group: &str) {
        let group = self.rig.net().hot_connect(group).unwrap();
        self.rig.until(group.joined()).unwrap();
    }

    fn leaves(&mut self, group: &str) {
        let group = self.rig.net().hot_connect(group).unwrap();
        self.rig.until(group.left()).unwrap();
    }

    fn events(&self) -> Vec<NetworkEvent> {
        let events = self.rig.net().events();
        std::iter::from_fn(|| events.try_next()).collect()
    }

    /// What kept a group from joining.
    fn refusals(&self) -> Vec<String> {
        let events = self.events().into_iter();
        let refusals = events.filter_map(|event| match event {
            NetworkEvent::NotJoined { why, .. } => Some(why),
            _ => None,
        });
        refusals.collect()
    }

    /// Nothing was done with the axis of the tool, and it is not enabled.
    fn sees_nothing_done(&self) {
        let segment = self.line.segment();
        let axis = segment.axis(TOOL, 0).unwrap();
        assert!(axis.ledger().is_empty());
        assert_ne!(axis.state(), State::OperationEnabled);
    }

    /// No cycle of the drive behind the tool was lost, and it has done what it was asked for, once.
    fn sees_others_undisturbed(&self, moves: usize) {
        let net = self.rig.net();
        let counted = net.drive_statistics();
        let behind = counted.iter().find(|one| one.drive.position == 1).unwrap();
        assert_eq!((behind.stale_cycles, behind.undelivered_cycles), (0, 0));
        let segment = self.line.segment();
        assert_eq!(segment.axis(BEHIND, 0).unwrap().ledger().len(), moves);
    }

    fn sees_x_moving(&mut self) {
        let at = |machine: &Self| machine.rig.net().axis("x").unwrap().status().position;
        let before = at(self);
        self.rig.run_for(20 * MS);
        assert!(at(self) > before);
    }

    fn failure_of_enable(&mut self, axis: &str) -> Option<Failure> {
        let axis = self.rig.net().axis(axis).unwrap();
        let failed = self.rig.until(axis.enable());
        failed.err().and_then(|error| error.failure())
    }
}

#[test]
fn a_tool_that_is_there_at_the_start_has_joined_by_then() {
    let mut machine = Machine::drill(tool(DRILL), true);
    let drill = machine.rig.net().hot_connect("drill").unwrap();
    assert!(drill.is_joined());
    machine.sees_nothing_done();
    for axis in ["x", "z"] {
        assert!(matches!(
            machine.rig.moved(axis, 5_000),
            Outcome::Reached { .. }
        ));
    }
    let net = machine.rig.net();
    // Its position is behind those of the others, with it and without.
    let positions: Vec<_> = net.drives().map(|drive| drive.position).collect();
    assert_eq!(positions, [1, 2]);
}

#[test]
fn a_tool_joins_beside_a_moving_axis_disabled_and_no_cycle_of_others_is_lost() {
    let mut machine = Machine::drill(tool(DRILL), false);
    let drill = machine.rig.net().hot_connect("drill").unwrap();
    assert!(!drill.is_joined());
    assert_eq!(machine.failure_of_enable("z"), Some(Failure::Absent));
    let sdo = machine.rig.net().sdo(DevicePlace::Alias(DRILL)).unwrap();
    let absent = machine.rig.until(sdo.read(obj::STATUSWORD)).unwrap_err();
    assert!(matches!(absent.error, SdoError::Absent { .. }), "{absent}");
    let asked = machine.rig.recover(2);
    assert!(matches!(asked, Err(NetworkError::Absent(_))), "{asked:?}");
    let (_mode, _x) = machine.rig.starts_a_long_move("x");
    machine.plug_in();
    machine.joins("drill");
    assert_eq!(
        machine.line.segment().device(TOOL).unwrap().al_state(),
        AlState::Op
    );
    machine.sees_nothing_done();
    assert!(machine.rig.until(sdo.read(obj::STATUSWORD)).is_ok());
    assert!(matches!(
        machine.rig.moved("z", 5_000),
        Outcome::Reached { .. }
    ));
    assert_eq!(
        machine.line.segment().axis(TOOL, 0).unwrap().ledger().len(),
        1
    );
    machine.sees_others_undisturbed(1);
    machine.sees_x_moving();
    assert_eq!(machine.rig.net().statistics().wrong_working_counters, 0);
    let joined = |event: &NetworkEvent| matches!(event, NetworkEvent::Joined { group, .. } if group == "drill");
    assert_eq!(
        machine
            .events()
            .iter()
            .filter(|event| joined(event))
            .count(),
        1
    );
}

#[test]
fn a_tool_that_is_pulled_ends_its_moves_and_comes_back_disabled() {
    for keeps_its_power in [true, false] {
        let mut machine = Machine::drill(tool(DRILL), true);
        let (_mode, _x) = machine.rig.starts_a_long_move("x");
        let (tool_mode, z) = machine.rig.starts_a_long_move("z");
        machine.rig.run_for(100 * MS);
        machine.unplug();
        if !keeps_its_power {
            machine.line.segment().device_mut(TOOL).unwrap().power_off();
        }
        machine.leaves("drill");
        let failure = machine.rig.until(z.done()).unwrap_err().failure();
        drop(tool_mode);
        assert!(
            matches!(failure, Some(Failure::BusLost { .. })),
            "{failure:?}"
        );
        assert_eq!(machine.failure_of_enable("z"), Some(Failure::Absent));
        machine.rig.run_for(500 * MS);
        let now = machine.rig.bus.now();
        if !keeps_its_power {
            machine
                .line
                .segment()
                .device_mut(TOOL)
                .unwrap()
                .power_on(now);
        }
        machine.plug_in();
        machine.joins("drill");
        machine.rig.run_for(500 * MS);
        let state = machine.line.segment().axis(TOOL, 0).unwrap().state();
        assert_ne!(state, State::OperationEnabled);
        assert!(matches!(
            machine.rig.moved("z", 5_000),
            Outcome::Reached { .. }
        ));
        machine.sees_x_moving();
        let left = |event: &NetworkEvent| matches!(event, NetworkEvent::Left { .. });
        assert_eq!(
            machine.events().iter().filter(|event| left(event)).count(),
            1
        );
    }
}

#[test]
fn a_pulled_connector_costs_the_others_no_more_than_the_cycle_in_which_it_breaks() {
    let mut machine = Machine::drill(tool(DRILL), true);
    let (_mode, _x) = machine.rig.starts_a_long_move("x");
    machine.unplug();
    machine.leaves("drill");
    machine.sees_others_undisturbed(1);
    machine.sees_x_moving();
}

#[test]
fn what_is_not_the_tool_is_named_and_stays_in_init() {
    let wrong = Servo::akd2g().alias(DRILL).build();
    for (device, says) in [
        (wrong, "another device"),
        (tool(0), "alias 0"),
        (tool(SAW), "alias 8"),
    ] {
        let mut machine = Machine::drill(device, false);
        machine.plug_in();
        machine.rig.run_for(3_000 * MS);
        assert!(!machine.rig.net().hot_connect("drill").unwrap().is_joined());
        let told = machine.events();
        let named: Vec<_> = told
            .iter()
            .filter(|event| {
                matches!(
                    event,
                    NetworkEvent::NotJoined { .. } | NetworkEvent::Stranger(_)
                )
            })
            .map(ToString::to_string)
            .collect();
        assert_eq!(named.len(), 1, "{named:?}");
        assert!(named[0].contains(says), "{named:?}");
        let state = machine.line.segment().device(TOOL).unwrap().al_state();
        assert_eq!(state, AlState::Init);
        machine.sees_nothing_done();
        machine.sees_others_undisturbed(0);
    }
}

#[test]
fn of_two_tools_with_one_alias_neither_joins() {
    let mut machine = Machine::drill(tool(DRILL), false);
    assert_eq!(machine.line.segment().attach(0, 2, tool(DRILL)), Some(3));
    machine.line.segment().unplug(3);
    machine.plug_in();
    machine.line.segment().plug_in(3);
    machine.rig.run_for(2_000 * MS);
    assert!(!machine.rig.net().hot_connect("drill").unwrap().is_joined());
    let refusals = machine.refusals();
    assert_eq!(refusals.len(), 1, "{refusals:?}");
    assert!(
        refusals[0].contains("not unique: positions 1, 3"),
        "{refusals:?}"
    );
    machine.sees_nothing_done();
    // Without the other one it joins.
    machine.line.segment().unplug(3);
    machine.joins("drill");
}

#[test]
fn tools_are_told_apart_by_what_their_switch_says() {
    let identified = Servo::pp2010().build().with_identification(21);
    let mut machine = Machine::with(identified, false, |builder| {
        let builder = optional(builder, "drill", DevicePlace::Identification(20), "z");
        optional(builder, "saw", DevicePlace::Identification(21), "w")
    });
    machine.plug_in();
    machine.joins("saw");
    assert_eq!(machine.failure_of_enable("z"), Some(Failure::Absent));
    assert!(matches!(
        machine.rig.moved("w", 5_000),
        Outcome::Reached { .. }
    ));
}

#[test]
fn a_tool_in_the_place_of_another_joins_as_itself() {
    let mut machine = Machine::with(tool(DRILL), true, |builder| {
        let builder = optional(builder, "drill", DevicePlace::Alias(DRILL), "z");
        optional(builder, "saw", DevicePlace::Alias(SAW), "w")
    });
    assert_eq!(machine.line.segment().attach(0, 2, tool(SAW)), Some(3));
    machine.line.segment().unplug(3);
    machine.unplug();
    machine.leaves("drill");
    machine.line.segment().plug_in(3);
    machine.joins("saw");
    assert!(matches!(
        machine.rig.moved("w", 5_000),
        Outcome::Reached { .. }
    ));
    assert_eq!(machine.failure_of_enable("z"), Some(Failure::Absent));
    // The other one joins again beside it, while it moves.
    let (_mode, w) = machine.rig.starts_a_long_move("w");
    machine.plug_in();
    machine.joins("drill");
    machine.rig.run_for(3_000 * MS);
    assert!(machine.rig.net().hot_connect("saw").unwrap().is_joined());
    machine.sees_others_undisturbed(0);
    let executed = machine.line.segment().axis(3, 0).unwrap().ledger().len();
    assert_eq!(executed, 2);
    drop(w);
}

#[test]
fn a_second_tool_with_the_alias_of_one_that_has_joined_is_told_of_and_stays_in_init() {
    let mut machine = Machine::drill(tool(DRILL), true);
    assert_eq!(machine.line.segment().attach(0, 2, tool(DRILL)), Some(3));
    machine.rig.run_for(4_000 * MS);
    assert!(machine.rig.net().hot_connect("drill").unwrap().is_joined());
    let told = machine.events();
    let strange = |event: &NetworkEvent| matches!(event, NetworkEvent::Stranger(present) if present.id.position == 3);
    assert!(told.iter().any(strange), "{told:?}");
    let state = machine.line.segment().device(3).unwrap().al_state();
    assert_eq!(state, AlState::Init);
}

#[test]
fn a_half_plugged_connector_stops_nobody() {
    let mut machine = Machine::drill(tool(DRILL), false);
    let (_mode, _x) = machine.rig.starts_a_long_move("x");
    machine.line.segment().half_plug(TOOL);
    machine.rig.run_for(3_000 * MS);
    let half: Vec<_> = machine
        .events()
        .into_iter()
        .filter(|event| matches!(event, NetworkEvent::HalfPlugged { port: 3, .. }))
        .collect();
    assert_eq!(half.len(), 1, "{half:?}");
    machine.sees_x_moving();
    let counted = machine.rig.net().drive_statistics();
    assert!(counted[0].stale_cycles < 10, "{counted:?}");
    // It is tried again after 5 s, and told of once.
    machine.rig.run_for(4_000 * MS);
    machine.sees_x_moving();
    assert!(machine.events().is_empty());
    let counted = machine.rig.net().drive_statistics();
    assert!(counted[0].stale_cycles < 20, "{counted:?}");
    // It is pulled, and put in as it should be.
    machine.unplug();
    machine.rig.run_for(500 * MS);
    machine.plug_in();
    machine.joins("drill");
    machine.sees_x_moving();
}

#[test]
fn a_connector_that_is_put_in_all_the_way_at_last_is_seen_without_being_pulled() {
    let mut machine = Machine::drill(tool(DRILL), false);
    machine.line.segment().half_plug(TOOL);
    machine.rig.run_for(1_000 * MS);
    machine.plug_in();
    machine.joins("drill");
}

#[test]
fn power_lost_anywhere_in_a_join_leaves_it_absent_until_it_joins_anew() {
    let mut whole = Machine::drill(tool(DRILL), false);
    whole.plug_in();
    let plugged = whole.rig.bus.now();
    whole.joins("drill");
    let takes = whole.rig.bus.now() - plugged;
    // From before its port is opened on.
    for before_the_end in (0..60).step_by(2) {
        let mut machine = Machine::drill(tool(DRILL), false);
        let (_mode, _x) = machine.rig.starts_a_long_move("x");
        machine.plug_in();
        machine.rig.run_for(takes - before_the_end * MS);
        machine.line.segment().device_mut(TOOL).unwrap().power_off();
        machine.rig.run_for(300 * MS);
        assert!(!machine.rig.net().hot_connect("drill").unwrap().is_joined());
        assert_eq!(machine.failure_of_enable("z"), Some(Failure::Absent));
        let now = machine.rig.bus.now();
        machine
            .line
            .segment()
            .device_mut(TOOL)
            .unwrap()
            .power_on(now);
        machine.joins("drill");
        machine.sees_nothing_done();
        machine.sees_others_undisturbed(1);
        machine.sees_x_moving();
        assert!(matches!(
            machine.rig.moved("z", 5_000),
            Outcome::Reached { .. }
        ));
    }
}

#[test]
fn a_tool_of_two_drives_is_there_as_a_whole_or_not_at_all() {
    let mut segment = Segment::new()
        .with(personality::coupler())
        .with(personality::akd2g());
    assert_eq!(segment.attach(0, 3, tool(DRILL)), Some(1));
    assert_eq!(segment.attach(1, 1, tool(SAW)), Some(2));
    let drive = |axis| unhomed(drives::pp2010(), &[axis]);
    let mut machine = Machine::of(segment, |builder| {
        builder.drive(1, akd2g()).optional("head", |group| {
            group
                .drive(DevicePlace::Alias(DRILL), drive("z"))
                .drive(DevicePlace::Alias(SAW), drive("w"))
        })
    });
    machine.joins("head");
    let (mode, z) = machine.rig.starts_a_long_move("z");
    machine.line.segment().unplug(2);
    machine.leaves("head");
    assert!(machine.rig.until(z.done()).is_err());
    drop(mode);
    machine.rig.run_for(1_000 * MS);
    assert_eq!(machine.failure_of_enable("z"), Some(Failure::Absent));
    let segment = machine.line.segment();
    assert_eq!(segment.device(1).unwrap().al_state(), AlState::Init);
    drop(segment);
    machine.line.segment().plug_in(2);
    machine.joins("head");
    for axis in ["z", "w"] {
        assert!(matches!(
            machine.rig.moved(axis, 5_000),
            Outcome::Reached { .. }
        ));
    }
}

#[test]
fn a_group_that_could_be_taken_for_others_is_refused() {
    let drive = |description: DriveDescription| unhomed(description, &["z"]);
    let net = || Network::builder().drive(0, akd2g());
    let of_akd = DevicePlace::Identity {
        vendor: drives::akd2g().vendor.unwrap_or(1),
        product: drives::akd2g().product.unwrap_or(1),
        serial: None,
    };
    for (builder, says) in [
        (net().optional("tool", |group| group), "it has no drive"),
        (
            net().optional("tool", |group| group.drive(1, drive(drives::pp2010()))),
            "declare it by its alias",
        ),
        (
            net().optional("tool", |group| {
                group.drive(DevicePlace::Alias(0), drive(drives::pp2010()))
            }),
            "alias 0 is that of devices without one",
        ),
        (
            net().optional("tool", |group| group.drive(of_akd, drive(drives::akd2g()))),
            "another device of the kind",
        ),
        (
            net()
                .optional("tool", |group| {
                    group.drive(DevicePlace::Alias(1), drive(drives::pp2010()))
                })
                .optional("tool", |group| {
                    group.drive(DevicePlace::Alias(2), unhomed(drives::pp2010(), &["w"]))
                }),
            "two optional groups are named",
        ),
    ] {
        let line = Line::new(Segment::new().with(personality::akd2g()));
        let error = Rig::start(builder.link(line.wire())).err().unwrap();
        assert!(error.to_string().contains(says), "{error}");
    }
}

#[test]
fn a_set_point_that_is_given_while_the_tool_is_out_is_refused_at_once() {
    let mut machine = Machine::drill(tool(DRILL), true);
    let z = machine.rig.net().axis("z").unwrap();
    machine.rig.until(z.enable()).unwrap();
    let mode = machine.rig.until(z.profile_position()).unwrap();
    machine.unplug();
    machine.leaves("drill");
    let refused = machine.rig.until(async {
        let set_point = SetPoint::new().velocity(10_000);
        match mode.move_abs(1_000, set_point).await {
            Ok(motion) => motion.done().await.map(drop),
            Err(error) => Err(error),
        }
    });
    assert_eq!(refused.unwrap_err().failure(), Some(Failure::Absent));
    machine.plug_in();
    machine.joins("drill");
    machine.rig.run_for(500 * MS);
    assert!(
        machine
            .line
            .segment()
            .axis(TOOL, 0)
            .unwrap()
            .ledger()
            .is_empty()
    );
}

#[test]
fn what_is_wrong_at_the_start_is_told_then_and_the_others_start() {
    let wrong = Servo::akd2g().alias(DRILL).build();
    let mut machine = Machine::drill(wrong, true);
    assert_eq!(machine.refusals().len(), 1);
    assert!(matches!(
        machine.rig.moved("x", 5_000),
        Outcome::Reached { .. }
    ));
    machine.sees_others_undisturbed(1);
    let mut segment = Segment::new()
        .with(personality::coupler())
        .with(personality::akd2g());
    assert_eq!(segment.attach(0, 3, tool(DRILL)), Some(1));
    assert_eq!(segment.attach(0, 2, tool(DRILL)), Some(3));
    let machine = Machine::of(segment, |builder| {
        let builder = builder.drive(1, akd2g());
        optional(builder, "drill", DevicePlace::Alias(DRILL), "z")
    });
    let refusals = machine.refusals();
    assert_eq!(refusals.len(), 1, "{refusals:?}");
    assert!(
        refusals[0].contains("not unique: positions 1, 3"),
        "{refusals:?}"
    );
    machine.sees_nothing_done();
}

#[test]
fn a_tool_that_leaves_op_is_reported_and_led_back_as_any_other_drive() {
    let mut machine = Machine::drill(tool(DRILL), true);
    let mut segment = machine.line.segment();
    segment.device_mut(TOOL).unwrap().fall_to_safe_op(0x001B);
    drop(segment);
    machine.rig.run_for(200 * MS);
    let told = machine.events();
    let fallen = |event: &NetworkEvent| matches!(event, NetworkEvent::LeftOp { drive, status } if drive.position == 2 && status.error == Some(0x001B));
    assert!(told.iter().any(fallen), "{told:?}");
    assert!(machine.rig.net().hot_connect("drill").unwrap().is_joined());
    machine.rig.recover(2).unwrap();
    assert!(matches!(
        machine.rig.moved("z", 5_000),
        Outcome::Reached { .. }
    ));
    machine.sees_others_undisturbed(0);
}

#[test]
fn a_tool_that_says_late_who_it_is_joins_late() {
    let mut machine = Machine::with(Servo::pp2010().build(), false, |builder| {
        optional(builder, "drill", DevicePlace::Identification(20), "z")
    });
    machine.plug_in();
    machine.rig.run_for(1_500 * MS);
    assert!(machine.events().is_empty());
    let mut segment = machine.line.segment();
    segment.device_mut(TOOL).unwrap().set_identification(20);
    drop(segment);
    machine.joins("drill");
    assert!(matches!(
        machine.rig.moved("z", 5_000),
        Outcome::Reached { .. }
    ));
}

#[test]
fn a_tool_out_for_a_moment_comes_back_disabled_however_long_its_watchdog_is() {
    for out in [1, 50, 250] {
        let mut machine = Machine::with(tool(DRILL), true, |builder| {
            let builder = builder.watchdog(3_000 * MS);
            optional(builder, "drill", DevicePlace::Alias(DRILL), "z")
        });
        let (_mode, z) = machine.rig.starts_a_long_move("z");
        machine.rig.run_for(100 * MS);
        machine.unplug();
        machine.rig.run_for(out * MS);
        machine.plug_in();
        machine.leaves("drill");
        machine.joins("drill");
        machine.rig.run_for(100 * MS);
        assert!(machine.rig.until(z.done()).is_err());
        let state = machine.line.segment().axis(TOOL, 0).unwrap().state();
        assert_ne!(state, State::OperationEnabled);
    }
}

#[test]
fn a_tool_is_never_taken_for_a_drive_of_its_kind_that_is_missing() {
    let mut segment = Segment::new()
        .with(personality::coupler())
        .with(personality::pp2010());
    assert_eq!(segment.attach(0, 3, tool(DRILL)), Some(TOOL));
    segment.unplug(TOOL);
    let mut machine = Machine::of(segment, |builder| {
        let builder = builder.drive(1, unhomed(description(), &["x"]));
        optional(builder, "drill", DevicePlace::Alias(DRILL), "z")
    });
    let mut segment = machine.line.segment();
    segment.device_mut(BEHIND).unwrap().power_off();
    drop(segment);
    machine.rig.run_for(200 * MS);
    machine.plug_in();
    for _ in 0..30 {
        assert!(machine.rig.recover(1).is_err());
        machine.rig.run_for(20 * MS);
    }
    machine.joins("drill");
    machine.sees_nothing_done();
    assert!(machine.rig.recover(1).is_err());
}

#[test]
fn a_tool_that_runs_with_the_address_of_a_drive_is_kept_out() {
    // On another machine, in the place of the drive here.
    let segment = Segment::new()
        .with(personality::coupler())
        .with(tool(DRILL));
    let elsewhere = Line::ideal(segment);
    let builder = Network::builder()
        .link(elsewhere.wire())
        .watchdog(6_000 * MS);
    let builder = builder.drive(1, unhomed(description(), &["x"]));
    let mut there = Rig::start(builder).unwrap();
    let x = there.net().axis("x").unwrap();
    there.until(x.enable()).unwrap();
    let mut machine = Machine::drill(tool(DRILL), false);
    let (_mode, _x) = machine.rig.starts_a_long_move("x");
    there.run_for(machine.rig.bus.now().saturating_sub(there.bus.now()));
    machine
        .rig
        .run_for(there.bus.now().saturating_sub(machine.rig.bus.now()));
    // It is pulled there with its power kept.
    std::mem::swap(
        elsewhere.segment().device_mut(1).unwrap(),
        machine.line.segment().device_mut(TOOL).unwrap(),
    );
    machine.plug_in();
    machine.rig.run_for(3_000 * MS);
    machine.sees_x_moving();
    assert!(
        machine
            .line
            .segment()
            .axis(TOOL, 0)
            .unwrap()
            .ledger()
            .is_empty()
    );
    let half = |event: &NetworkEvent| matches!(event, NetworkEvent::HalfPlugged { .. });
    assert!(machine.events().iter().any(half));
}
