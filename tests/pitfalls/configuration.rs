//! Pitfalls 30 to 36, as far as the mapping's declaration and plan decide them.

use std::collections::BTreeMap;

use servocrab::SetPoint;
use servocrab::axis::AxisFields;
use servocrab::coe::{AxisOffset, Mappable, Object, ReadWrite, obj};
use servocrab::drives;
use servocrab::pdo_map::{Direction, Mapping, MappingError, MappingLimits};
use servocrab_sim::ds402::{Behaviour, ModeZero};

use crate::common::Rig;

fn number(bytes: &[u8]) -> u32 {
    let mut raw = [0; 4];
    raw[..bytes.len()].copy_from_slice(bytes);
    u32::from_le_bytes(raw)
}

#[test]
fn pitfall_30_a_mapping_is_emptied_before_it_is_written() {
    let mapping = drives::akd2g().default_mapping().expect("a mapping");
    // A drive that holds another mapping, and refuses a subindex while subindex 0 is not 0.
    let mut held = BTreeMap::new();
    for index in [
        0x1C12_u16, 0x1C13, 0x1600, 0x1601, 0x1610, 0x1A00, 0x1A01, 0x1A10,
    ] {
        held.insert((index, 0), 4);
    }
    for step in mapping.plan().steps() {
        let (index, subindex) = (step.object.index, step.object.subindex);
        let assigned = if index < 0x1A00 { 0x1C12 } else { 0x1C13 };
        if subindex != 0 {
            assert_eq!(held[&(index, 0)], 0, "{step}: subindex 0 is not 0");
        }
        if index < 0x1C00 {
            assert_eq!(held[&(assigned, 0)], 0, "{step}: the PDO is assigned");
        }
        held.insert((index, subindex), number(step.value()));
    }
    for (assignment, pdos) in [(0x1C12, mapping.outputs()), (0x1C13, mapping.inputs())] {
        assert_eq!(held[&(assignment, 0)] as usize, pdos.len());
        for pdo in pdos {
            assert_eq!(held[&(pdo.index, 0)] as usize, pdo.entries.len());
        }
    }
}

#[test]
fn pitfall_32_more_than_eight_entries_are_refused_where_the_drive_takes_eight() {
    let mut builder = Mapping::builder()
        .limits(MappingLimits {
            entries_per_pdo: 8,
            ..MappingLimits::default()
        })
        .rx_pdo(0x1600);
    for subindex in 1..=9 {
        let byte: Object<u8, ReadWrite> =
            Object::new(0x2000, subindex, "byte").mappable(Mappable::OUTPUTS);
        builder = builder.output(byte);
    }
    assert!(matches!(
        builder.build(),
        Err(MappingError::TooManyEntries {
            entries: 9,
            limit: 8,
            ..
        })
    ));
}

#[test]
fn pitfall_33_a_mapped_6060h_carries_the_mode_in_every_frame() {
    let behaviour = Behaviour {
        mode_zero: ModeZero::Clears,
        ..Behaviour::akd2g()
    };
    let mut rig = Rig::new(behaviour, |_| {});
    rig.enable();
    let id = rig.abs(10_000, SetPoint::new());
    rig.run_until(2_000, |rig| {
        assert_eq!(rig.outputs[2], 1, "modes of operation");
        rig.outcome(id).is_some()
    });
    assert!(rig.finish(id).is_ok());
}

#[test]
fn pitfall_34_the_position_window_time_is_16_bits_wide() {
    let layout = Mapping::builder()
        .rx_pdo(0x1600)
        .output(obj::POSITION_WINDOW_TIME)
        .output(obj::CONTROLWORD)
        .build()
        .expect("a mapping")
        .layout();
    assert_eq!(layout.output_bytes(), 4);
}

#[test]
fn pitfall_35_a_mapping_of_inputs_alone_is_taken_and_empties_the_outputs() {
    let mapping = Mapping::builder()
        .tx_pdo(0x1A00)
        .input(obj::STATUSWORD)
        .build()
        .expect("inputs alone");
    assert_eq!(mapping.layout().output_bytes(), 0);
    assert_eq!(mapping.layout().input_bytes(), 2);
    let plan = mapping.plan();
    let mut outputs = plan
        .steps()
        .iter()
        .filter(|step| step.object.index == 0x1C12);
    let only = outputs.next().expect("1C12h is written");
    assert_eq!((only.object.subindex, only.value()), (0, &[0][..]));
    assert!(outputs.next().is_none());
}

#[test]
fn pitfall_36_the_second_axis_has_its_own_objects_pdos_and_places() {
    let mapping = drives::akd2g().default_mapping().expect("a mapping");
    let indices = |direction| -> Vec<(u16, u16)> {
        let pdos = mapping.pdos(direction);
        pdos.iter()
            .map(|pdo| (pdo.index, pdo.entries[0].index))
            .collect()
    };
    // "6040h, 6840h Controlword"; one RxPDO and one TxPDO for each axis.
    assert_eq!(
        indices(Direction::Outputs),
        [(0x1600, 0x6040), (0x1610, 0x6840)]
    );
    assert_eq!(
        indices(Direction::Inputs),
        [(0x1A00, 0x6041), (0x1A10, 0x6841)]
    );
    let layout = mapping.layout();
    let [first, second] = [1, 2].map(|axis| {
        AxisFields::from_layout(&layout, AxisOffset::of_axis(axis)).expect("all objects")
    });
    assert_eq!((first.controlword, first.statusword), (0, 0));
    assert_eq!((second.controlword, second.statusword), (19, 11));
}
