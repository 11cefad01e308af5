//! The table of `docs/drives.md` is what `servocrab::drives` says, and the simulated drives take what it says.

use std::fmt::Write;
use std::fs;
use std::path::PathBuf;

use servocrab::drives::{self, DriveDescription};
use servocrab::pdo_map::Direction;
use servocrab::sii::Identity;
use servocrab::{
    BufferMode,
    profile_position::{
        BufferSignal, LimitsActive, LimitsOff, MinVelocity, RelativeBase, StartBits,
    },
};
use servocrab_sim::{Device, personality};

const BEGIN: &str = "<!-- written by `WRITE_DRIVES=1 cargo test --test motion drives` -->\n";
const END: &str = "<!-- end of what is written -->\n";

/// The program's name for it, the library's description and the simulated drive.
fn all() -> [(&'static str, DriveDescription, Device); 5] {
    [
        ("akd2g", drives::akd2g(), personality::akd2g()),
        ("pp2010", drives::pp2010(), personality::pp2010()),
        ("ax2000", drives::ax2000(), personality::ax2000()),
        ("sigma7", drives::sigma7(), personality::sigma7()),
        ("generic", drives::generic(), personality::generic()),
    ]
}

fn number(id: Option<u32>) -> String {
    id.map_or("any".to_owned(), |id| format!("{id:08X}h"))
}

fn pdos(drive: &DriveDescription) -> String {
    let axes: Vec<_> = drive
        .axes
        .iter()
        .map(|axis| format!("{:04X}h, {:04X}h", axis.rx_pdos[0], axis.tx_pdos[0]))
        .collect();
    axes.join("; ")
}

fn objects(drive: &DriveDescription, direction: Direction) -> String {
    let mut first = drive.clone();
    first.axes.truncate(1);
    let layout = first.default_mapping().expect("a mapping").layout();
    let objects: Vec<_> = layout
        .objects(direction)
        .map(|(object, _)| format!("{:04X}h", object.index))
        .collect();
    objects.join(" ")
}

fn start(drive: &DriveDescription, buffer_mode: BufferMode) -> String {
    match drive.traits.bits(buffer_mode) {
        StartBits::Bits {
            change_set_immediately,
            change_on_set_point,
        } => match (change_set_immediately, change_on_set_point) {
            (false, false) => "bits 5 and 9 low".to_owned(),
            (true, false) => "bit 5".to_owned(),
            (false, true) => "bit 9".to_owned(),
            (true, true) => "bits 5 and 9".to_owned(),
        },
        StartBits::Sequenced => "sent after arrival".to_owned(),
        StartBits::Unsupported(reason) => format!("refused: {reason}"),
        other => panic!("no words for {other:?}"),
    }
}

fn ramps(drive: &DriveDescription) -> String {
    let types: Vec<_> = drive
        .traits
        .profile_types
        .iter()
        .map(ToString::to_string)
        .collect();
    match (types.is_empty(), drive.traits.blend_needs_linear_ramps) {
        (true, _) => "sent as asked for".to_owned(),
        (false, true) => format!("{}; blends with 0 only", types.join(", ")),
        (false, false) => types.join(", "),
    }
}

fn limits(drive: &DriveDescription) -> String {
    let rule = drive.traits.limits;
    let off = match rule.off {
        LimitsOff::MinNotBelowMax => "off where min ≥ max",
        LimitsOff::BothZero => "off where both are 0",
    };
    let active = match rule.active {
        LimitsActive::Always => "always in force",
        LimitsActive::WhenReferenced => "in force once the axis is referenced",
    };
    let offset = if rule.less_home_offset {
        "less 607Ch"
    } else {
        "as they are"
    };
    format!("{offset}; {off}; {active}")
}

type Cell = fn(&DriveDescription) -> String;

const ROWS: [(&str, Cell); 16] = [
    ("vendor", |drive| number(drive.vendor)),
    ("product", |drive| number(drive.product)),
    ("RxPDO, TxPDO of each axis", pdos),
    ("objects written each cycle", |drive| {
        objects(drive, Direction::Outputs)
    }),
    ("objects read each cycle", |drive| {
        objects(drive, Direction::Inputs)
    }),
    ("most entries in a PDO", |drive| {
        drive.limits.entries_per_pdo.to_string()
    }),
    ("`BufferMode::Aborting`", |drive| {
        start(drive, BufferMode::Aborting)
    }),
    ("`BufferMode::Buffered`", |drive| {
        start(drive, BufferMode::Buffered)
    }),
    ("`BufferMode::Blending`", |drive| {
        start(drive, BufferMode::Blending)
    }),
    ("bits 5, 6 and 9 go out", |drive| {
        if drive.traits.start_bits_first {
            "two drive cycles before bit 4".to_owned()
        } else {
            "with bit 4".to_owned()
        }
    }),
    ("bit 12 is taken to show", |drive| {
        match drive.traits.buffer_signal {
            BufferSignal::Acknowledge => "room in the buffer",
            BufferSignal::None => "bit 4",
            BufferSignal::Unknown => "bit 4, or room in the buffer",
            other => panic!("no words for {other:?}"),
        }
        .to_owned()
    }),
    ("relative moves count from", |drive| {
        match drive.traits.relative_base {
            RelativeBase::PreviousTarget => "the previous target",
            RelativeBase::Demand => "6062h",
            RelativeBase::Actual => "6064h",
            RelativeBase::PositioningOption => "what 60F2h says",
            RelativeBase::Undocumented => "not documented",
            other => panic!("no words for {other:?}"),
        }
        .to_owned()
    }),
    ("halted set-points", |drive| {
        if drive.traits.halt_keeps_set_point {
            "kept".to_owned()
        } else {
            "lost".to_owned()
        }
    }),
    ("6086h", ramps),
    ("607Dh", limits),
    ("2010h", |drive| {
        match drive.traits.limits.min_velocity {
            MinVelocity::Absent => "not read",
            MinVelocity::UnitUnknown => {
                "shown: the least velocity, in a unit that is not documented"
            }
            MinVelocity::AsProfileVelocity => "slower moves and jogs are refused",
        }
        .to_owned()
    }),
];

fn table() -> String {
    let drives = all();
    let mut table = "| |".to_owned();
    for (name, ..) in &drives {
        let _ = write!(table, " `{name}` |");
    }
    table.push_str("\n|---|---|---|---|---|---|\n");
    for (row, cell) in ROWS {
        let _ = write!(table, "| {row} |");
        for (_, drive, _) in &drives {
            let _ = write!(table, " {} |", cell(drive));
        }
        table.push('\n');
    }
    table
}

#[test]
fn the_pages_table_is_what_the_descriptions_say() {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("docs/drives.md");
    let page = fs::read_to_string(&path).expect("the page");
    let (before, rest) = page.split_once(BEGIN).expect("where the table begins");
    let (_, after) = rest.split_once(END).expect("where it ends");
    let written = format!("{before}{BEGIN}\n{}\n{END}{after}", table());
    if std::env::var_os("WRITE_DRIVES").is_some() {
        fs::write(&path, &written).expect("docs/ can be written");
    }
    let page = fs::read_to_string(&path).expect("the page");
    assert!(
        page == written,
        "docs/drives.md is not what src/drives says; write it with\n    \
         WRITE_DRIVES=1 cargo test --test motion drives"
    );
}

#[test]
fn each_description_matches_its_simulated_drive_and_only_generic_ones_match_others() {
    let drives = all();
    for (name, description, _) in &drives {
        for (other, _, device) in &drives {
            let simulated = device.description().identity;
            let identity = Identity {
                vendor: simulated.vendor,
                product: simulated.product,
                revision: simulated.revision,
                serial: simulated.serial,
            };
            let anonymous = description.vendor.is_none();
            assert_eq!(
                description.matches(&identity),
                name == other || anonymous,
                "{name} with {other}"
            );
        }
    }
}

#[test]
fn a_known_identity_gets_its_description_and_no_other_gets_one() {
    for known in [drives::akd2g(), drives::ax2000(), drives::sigma7()] {
        let identity = Identity {
            vendor: known.vendor.expect("a vendor"),
            product: 7,
            ..Identity::default()
        };
        assert_eq!(drives::for_identity(&identity), Some(known));
    }
    let of_nobody = Identity {
        vendor: 0x7FFF_FFFF,
        ..Identity::default()
    };
    assert_eq!(drives::for_identity(&of_nobody), None);
}
