//! What programs log or show, as JSON (feature `serde`): the names of the fields are what others read.

use std::time::Duration;

use serde_json::{Value, json};
use servocrab::{
    AxisConfig, DriveConfig, Network, Referencing, SetPoint, drives,
    link::Wire,
    units::{Mm, Ratio, Scale},
};
use servocrab_sim::{Segment, personality};

use crate::rig::{Line, Rig, turn_until};

fn as_json(value: &impl serde::Serialize) -> Value {
    serde_json::to_value(value).unwrap()
}

#[test]
fn a_snapshot_an_outcome_an_error_and_a_black_box_are_written_with_their_units_and_names() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let scale = Scale::counts_per_unit(Ratio::new(1000, 1).unwrap());
    let x = AxisConfig::new("x")
        .referencing(Referencing::AbsoluteEncoder)
        .unit::<Mm>(scale);
    let drive = DriveConfig::new(drives::akd2g()).axis(x);
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, drive)).unwrap();
    let axis = rig.net().axis_in::<Mm>("x").unwrap();
    rig.until(axis.enable()).unwrap();
    let lease = rig.until(axis.profile_position()).unwrap();
    let fast = SetPoint::new().velocity(50.0).acceleration(500.0);
    let outcome = rig.until(async { lease.move_abs(2.0, fast).await?.done().await });
    let outcome = as_json(&outcome.unwrap());
    let arrived = outcome["Reached"]["position"].as_f64().unwrap();
    assert!((arrived - 2.0).abs() < 0.011, "{outcome}");

    let snapshot = as_json(&axis.status());
    assert_eq!(snapshot["state"], json!("OperationEnabled"));
    assert_eq!(snapshot["mode"], json!("ProfilePosition"));
    let word = u64::from(axis.status().statusword.bits());
    assert_eq!(snapshot["statusword"], json!(word));
    assert_eq!(snapshot["position"], json!(axis.status().position));

    let refused = rig.until(lease.move_abs(1.0, fast.velocity(0.0)));
    let refused = as_json(&refused.unwrap_err());
    assert_eq!(refused["identity"]["axis"], json!("x"));
    assert_eq!(refused["identity"]["drive"]["position"], json!(0));
    assert!(
        refused["error"].as_str().unwrap().contains("velocity"),
        "{refused}"
    );

    let (bus, net) = (&mut rig.bus, rig.net.as_ref().unwrap());
    let black_box = as_json(&turn_until(bus, net.black_box("x")).unwrap());
    assert_eq!(black_box["axis"]["axis"], json!("x"));
    assert_eq!(black_box["incident"], Value::Null);
    let last = black_box["cycles"].as_array().unwrap().last().unwrap();
    assert_eq!(last["answered"], json!("Delivered"));
    assert!(last["inputs"]["position"].is_i64(), "{last}");
    rig.shutdown();
}

#[test]
fn statistics_and_histograms_are_written_as_counts_and_nanoseconds() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let drive = DriveConfig::new(drives::akd2g()).axis(AxisConfig::new("x"));
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, drive)).unwrap();
    rig.run_for(Duration::from_millis(100));
    let counted = rig.net().statistics();
    let statistics = as_json(&counted);
    assert_eq!(statistics["cycles"], json!(counted.cycles));
    assert_eq!(statistics["wakes"]["panicked"], json!(0));
    let timing = as_json(&rig.net().timing());
    let trips = &timing["round_trip"];
    assert_eq!(trips["least_ns"], json!(10_000));
    assert_eq!(trips["p99_ns"], json!(10_000));
    let buckets = trips["buckets"].as_array().unwrap();
    let counted: u64 = buckets
        .iter()
        .map(|bucket| bucket[2].as_u64().unwrap())
        .sum();
    assert_eq!(trips["count"], json!(counted));
    rig.shutdown();
}

#[test]
fn a_scanned_device_is_written_with_what_it_says_it_is() {
    let mut segment = Segment::new().with(personality::akd2g());
    let wire = Wire::new(move |frame: &mut [u8], now| segment.process(frame, now));
    let line = smol::block_on(Network::builder().link(wire).scan()).unwrap();
    let device = as_json(&line.devices()[0]);
    let identity = line.devices()[0].id.identity;
    assert_eq!(device["id"]["identity"]["vendor"], json!(identity.vendor));
    assert_eq!(device["found_in"]["state"], json!("Init"));
    assert_eq!(device["problem"], Value::Null);
    assert_eq!(device.get("sdo"), None);
}
