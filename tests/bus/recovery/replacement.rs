//! Drives that are replaced: accepted or refused, given the alias and the parameters of the old one, and interrupted at every step.

use std::{
    pin::pin,
    sync::{Arc, Mutex},
    task::{Context, Waker},
};

use servocrab::{
    AxisConfig, DriveConfig, Failure, Network, NetworkError, Referencing,
    bus::{AlState as Al, BringUpStep, DevicePlace, DriveFault, LineVerdict, Recovered},
    coe::{ObjectAddress, obj},
    drives,
    link::Fate,
    parameters::{MemoryFault, ObjectValue, Parameter, ParameterSet, RestoreFault},
    sii::{Identity, SiiImage},
};
use servocrab_sim::{
    AlState, Device, EepromReload, Identity as Plate, ds402::State, personality::Servo,
};

use super::{MIDDLE, MS, Yard, set_point, unhomed};
use crate::rig::datagrams;

const ALIAS: u16 = 7;
/// Where the old drive had its limits, and how fast it was at most.
const HELD: [(u16, u8, i64); 3] = [
    (0x607D, 1, -700_000),
    (0x607D, 2, 800_000),
    (0x607F, 0, 900_000),
];

fn drive(serial: u32) -> Device {
    let mut device = Servo::sigma7().serial(serial).build();
    device.set_sii_write_delay(2 * MS);
    device.set_eeprom_reload(EepromReload::WithAlias);
    device
}

fn config() -> DriveConfig {
    unhomed(drives::sigma7(), &["z"])
}

fn backup() -> ParameterSet {
    let mut set = ParameterSet::default();
    for (index, subindex, value) in HELD {
        set.parameters.push(Parameter {
            object: ObjectAddress::new(index, subindex),
            name: String::new(),
            value: match index {
                0x607F => ObjectValue::U32(u32::try_from(value).unwrap()),
                _ => ObjectValue::I32(i32::try_from(value).unwrap()),
            },
        });
    }
    set
}

/// The one with serial number 1, declared by its alias.
fn by_alias(yard: impl FnOnce(&crate::rig::Line) -> servocrab::bus::NetworkBuilder) -> Yard {
    let mut old = Servo::sigma7().serial(1).alias(ALIAS).build();
    old.set_sii_write_delay(2 * MS);
    Yard::placed(old, DevicePlace::Alias(ALIAS), config(), yard)
}

impl Yard {
    /// Another one stands in the middle, and has just been switched on.
    fn is_exchanged(&mut self, for_another: Device) {
        self.line.segment().device_mut(MIDDLE).unwrap().power_off();
        self.rig.run_for(300 * MS);
        let now = self.rig.bus.now();
        let mut segment = self.line.segment();
        let middle = segment.device_mut(MIDDLE).unwrap();
        *middle = for_another;
        middle.power_off();
        middle.power_on(now);
        drop(segment);
        self.rig.run_for(100 * MS);
    }

    fn replace(&mut self, serial: u32, backup: &ParameterSet) -> Result<Recovered, NetworkError> {
        let net = self.rig.net.take().unwrap();
        let replaced = self.rig.until(net.replace("z", serial, backup));
        self.rig.net = Some(net);
        replaced
    }

    fn messages(&self) -> u64 {
        self.line.segment().device(MIDDLE).unwrap().messages_taken()
    }

    fn image(&self) -> Option<SiiImage> {
        let segment = self.line.segment();
        SiiImage::new(segment.device(MIDDLE).unwrap().eeprom()).ok()
    }

    fn held(&self) -> Vec<(u16, u8, i64)> {
        let segment = self.line.segment();
        let axis = segment.axis(MIDDLE, 0).unwrap();
        let held = HELD
            .iter()
            .map(|(index, subindex, _)| (*index, *subindex, axis.get(*index, *subindex).unwrap()));
        held.collect()
    }

    /// Cycles in which the first drive has not answered.
    fn missed(&self) -> u64 {
        let drives = self.rig.net().drive_statistics();
        let first = drives.iter().find(|drive| drive.drive.position == 0);
        first.unwrap().stale_cycles
    }

    /// In OP with what the old one had, and its axis disabled and not referenced.
    fn is_replaced(&self, what: &str) {
        assert_eq!(self.state(MIDDLE), AlState::Op, "{what}");
        assert_eq!(self.held(), HELD, "{what}");
        let status = self.axis("z").status();
        assert!(!status.lost && !status.referenced, "{what}: {status:?}");
        let segment = self.line.segment();
        let state = segment.axis(MIDDLE, 0).unwrap().state();
        assert!(
            !matches!(state, State::OperationEnabled | State::QuickStopActive),
            "{what}: {state:?}"
        );
    }
}

/// The verdict of the table that the error shows.
fn is_different(error: &NetworkError) -> bool {
    matches!(error, NetworkError::WrongLine(table) if table.0[0].verdict == LineVerdict::Different)
}

fn fault(error: NetworkError) -> (BringUpStep, DriveFault) {
    match error {
        NetworkError::Drive { step, error, .. } => (step, *error),
        other => panic!("{other}"),
    }
}

const ANEW: Recovered = Recovered::BroughtUp {
    position: 1,
    from: None,
};

#[test]
fn a_drive_with_another_serial_number_is_refused_until_that_is_accepted_and_is_then_the_one_of_its_place()
 {
    let mut yard = Yard::new(drive(1), config());
    yard.is_exchanged(drive(2));
    yard.nothing_may_happen();
    let eeprom = yard.image().unwrap();
    let error = yard.recover(1).unwrap_err();
    assert!(is_different(&error), "{error}");
    assert!(error.to_string().contains("serial 00000002h"), "{error}");
    let error = yard.replace(3, &backup()).unwrap_err();
    assert!(is_different(&error), "{error}");
    assert!(error.to_string().contains("serial 00000002h"), "{error}");
    assert!(error.to_string().contains("serial 00000003h"), "{error}");
    assert_eq!((yard.state(MIDDLE), yard.messages()), (AlState::Init, 0));

    assert_eq!(yard.replace(2, &backup()).unwrap(), ANEW);
    yard.is_replaced("accepted");
    assert_eq!(yard.image(), Some(eeprom), "no alias was declared");
    assert_eq!(yard.recover(1).unwrap(), Recovered::WasInOp);
    assert_eq!(yard.replace(2, &backup()).unwrap(), Recovered::WasInOp);
    // Of one that runs no other one is taken for it.
    let error = yard.replace(1, &backup()).unwrap_err();
    assert!(is_different(&error), "{error}");
    assert_eq!(yard.state(MIDDLE), AlState::Op);
    yard.nothing_has_happened();
    yard.works_again("z");

    // It is known from now on, and holds what it has stored.
    yard.loses_power(300 * MS);
    assert_eq!(yard.held(), HELD);
    yard.nothing_may_happen();
    assert_eq!(yard.recover(1).unwrap(), ANEW);
    yard.nothing_has_happened();
    // The old one is not, any more.
    yard.is_exchanged(drive(1));
    assert!(is_different(&yard.recover(1).unwrap_err()));
    assert_eq!(yard.replace(1, &backup()).unwrap(), ANEW);
    yard.works_again("z");
    yard.ends();
}

#[test]
fn what_may_not_stand_in_place_of_the_drive_is_named_and_nothing_is_written_to_it() {
    let plate = |product, revision| Plate {
        vendor: 0x0539,
        product,
        revision,
        serial: 2,
    };
    let of_another_kind = ParameterSet {
        identity: Some(Identity {
            vendor: 0x0539,
            product: 1,
            revision: 1,
            serial: 1,
        }),
        ..backup()
    };
    let a_command = ParameterSet {
        parameters: vec![Parameter {
            object: obj::CONTROLWORD.address(),
            name: String::new(),
            value: ObjectValue::U16(15),
        }],
        ..ParameterSet::default()
    };
    type Check = fn(NetworkError) -> bool;
    let rows: [(&str, Plate, ParameterSet, Check); 4] = [
        ("another product", plate(5, 2), backup(), |error| {
            is_different(&error) && error.to_string().contains("00000539h:00000005h")
        }),
        (
            "an older revision",
            plate(0x5347_4437, 1),
            backup(),
            |error| {
                matches!(
                    fault(error),
                    (
                        BringUpStep::Identity,
                        DriveFault::OlderRevision {
                            expected: 2,
                            got: 1
                        }
                    )
                )
            },
        ),
        (
            "a backup of another kind",
            plate(0x5347_4437, 2),
            of_another_kind,
            |error| {
                matches!(
                    fault(error).1,
                    DriveFault::Restore(RestoreFault::OtherDrive { .. })
                )
            },
        ),
        (
            "a backup with a command",
            plate(0x5347_4437, 2),
            a_command,
            |error| {
                matches!(
                    fault(error).1,
                    DriveFault::Restore(RestoreFault::NoParameter(_))
                )
            },
        ),
    ];
    for (what, plate, backup, is_named) in rows {
        let old = Servo::sigma7().identity(Plate {
            revision: 2,
            serial: 1,
            ..plate_of_the_old()
        });
        let mut yard = Yard::new(old.build(), config());
        yard.is_exchanged(Servo::sigma7().identity(plate).build());
        yard.nothing_may_happen();
        let eeprom = yard.image();
        let error = yard.replace(2, &backup).unwrap_err();
        let text = error.to_string();
        assert!(is_named(error), "{what}: {text}");
        assert_eq!(yard.messages(), 0, "{what}");
        assert_eq!(yard.state(MIDDLE), AlState::Init, "{what}");
        assert_eq!(yard.image(), eeprom, "{what}");
        yard.nothing_has_happened();
        yard.ends();
    }
}

fn plate_of_the_old() -> Plate {
    Plate {
        vendor: 0x0539,
        product: 0x5347_4437,
        revision: 1,
        serial: 1,
    }
}

#[test]
fn a_higher_revision_and_a_drive_that_comes_with_its_power_on_are_taken_too() {
    let newer = Plate {
        revision: 5,
        serial: 2,
        ..plate_of_the_old()
    };
    let mut yard = Yard::new(drive(1), config());
    yard.is_exchanged(Servo::sigma7().identity(newer).build());
    yard.nothing_may_happen();
    assert_eq!(yard.replace(2, &backup()).unwrap(), ANEW);
    yard.is_replaced("newer");
    yard.nothing_has_happened();
    // From another machine, where it had the same station address.
    let mut there = Yard::new(
        Servo::sigma7()
            .identity(Plate { serial: 3, ..newer })
            .build(),
        config(),
    );
    for yard in [&mut yard, &mut there] {
        yard.falls(0x001B);
    }
    std::mem::swap(
        yard.line.segment().device_mut(MIDDLE).unwrap(),
        there.line.segment().device_mut(MIDDLE).unwrap(),
    );
    yard.rig.run_for(20 * MS);
    yard.nothing_may_happen();
    let error = yard.replace(4, &backup()).unwrap_err();
    assert!(is_different(&error), "{error}");
    assert_eq!(yard.state(MIDDLE), AlState::SafeOp, "it is left alone");
    let replaced = yard.replace(3, &backup()).unwrap();
    assert!(
        matches!(replaced, Recovered::BroughtUp { from: Some(_), .. }),
        "{replaced}"
    );
    yard.is_replaced("with its power on");
    yard.nothing_has_happened();
    yard.works_again("z");
    yard.ends();
    drop(there);
}

#[test]
fn what_the_encoder_of_a_replaced_drive_says_is_no_reference_until_its_axis_is_homed() {
    let absolute = || Servo::sigma7().absolute_encoder();
    let lift = AxisConfig::new("z").referencing(Referencing::AbsoluteEncoder);
    let config = DriveConfig::new(drives::sigma7()).axis(lift);
    let mut yard = Yard::new(absolute().serial(1).build(), config);
    let z = yard.axis("z");
    assert!(z.status().referenced);
    yard.is_exchanged(absolute().serial(2).build());
    yard.replace(2, &backup()).unwrap();
    yard.is_replaced("replaced");
    let refused = yard.rig.until(async {
        z.enable().await.unwrap();
        let mode = z.profile_position().await.unwrap();
        mode.move_abs(700, set_point()).await.unwrap_err()
    });
    assert_eq!(refused.failure(), Some(Failure::NotReferenced));
    // Nor after it has been without power.
    yard.loses_power(300 * MS);
    yard.recover(1).unwrap();
    yard.is_replaced("recovered");
    let z = yard.is_homed_here("z", 700);
    assert!(z.status().referenced);
    yard.ends();
}

#[test]
fn a_drive_that_does_not_store_its_parameters_is_named_and_a_backup_without_any_needs_no_memory() {
    let mut yard = Yard::new(
        Servo::generic().serial(1).build(),
        unhomed(drives::generic(), &["z"]),
    );
    yard.is_exchanged(Servo::generic().serial(2).build());
    yard.nothing_may_happen();
    let one = ParameterSet {
        parameters: backup().parameters.split_off(2),
        ..ParameterSet::default()
    };
    let error = yard.replace(2, &one).unwrap_err();
    let (step, fault) = fault(error);
    assert_eq!(step, BringUpStep::Store);
    assert!(
        matches!(fault, DriveFault::Store(MemoryFault::NotThere { .. })),
        "{fault}"
    );
    assert_eq!(yard.state(MIDDLE), AlState::Init);
    assert!(yard.replace(2, &ParameterSet::default()).is_ok());
    yard.nothing_has_happened();
    yard.works_again("z");
    yard.ends();
}

/// A moment of a replacement: a datagram to the drive in the middle.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Moment {
    /// It gets a station address: a provisional one, and then its own.
    Address,
    /// This is written to AL control.
    State(u8),
    /// A word of its EEPROM is written.
    Word,
    /// Its EEPROM is loaded again.
    Reload,
    /// This object is written.
    Download(u16),
}

impl Moment {
    fn of(datagram: &[u8]) -> Option<Self> {
        let [command, _, a0, a1, r0, r1, ..] = *datagram else {
            return None;
        };
        let (address, register) = (u16::from_le_bytes([a0, a1]), u16::from_le_bytes([r0, r1]));
        let data = datagram.get(10..)?;
        match (command, address, register) {
            // By its position, or by its provisional address.
            (2, 0xFFFF, 0x0010) | (5, 0x2000, 0x0010) => Some(Self::Address),
            (5, 0x1001, 0x0120) => Some(Self::State(data[0] & 0x0F)),
            (5, 0x1001, 0x0502) => match data[1] {
                2 => Some(Self::Word),
                4 => Some(Self::Reload),
                _ => None,
            },
            (5, 0x1001, 0x1000..) if data[5] & 0x0F == 3 && data[7] == 0x20 => {
                let is_download = data[8] & 0xE0 == 0x20;
                is_download.then(|| Self::Download(u16::from_le_bytes([data[9], data[10]])))
            }
            _ => None,
        }
    }
}

impl Moment {
    /// The step that the error names when the power goes at that moment.
    fn fails_in(self, has_its_address: bool) -> BringUpStep {
        match self {
            Self::Address if has_its_address => BringUpStep::Sii,
            Self::Address => BringUpStep::Identity,
            Self::State(1) => BringUpStep::State(Al::Init),
            Self::Word | Self::Reload => BringUpStep::Alias,
            Self::State(2) => BringUpStep::State(Al::PreOp),
            Self::Download(0x607D | 0x607F) => BringUpStep::Restore,
            Self::Download(0x1010) => BringUpStep::Store,
            Self::Download(0x1C12 | 0x1C13) => BringUpStep::Mapping,
            Self::State(4) => BringUpStep::State(Al::SafeOp),
            Self::Download(0x6007) => BringUpStep::AbortConnection,
            Self::State(8) => BringUpStep::State(Al::Op),
            other => panic!("{other:?} is of no step"),
        }
    }
}

/// When the power goes: with the datagram, which does not come then, or with the next frame after it.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Cut {
    Before,
    After,
}

/// What is seen of the drive in the middle, and the moment at which its power goes.
#[derive(Default)]
struct Watch {
    seen: Vec<Moment>,
    cut: Option<(usize, Cut)>,
    now: bool,
}

fn watched() -> (Yard, Arc<Mutex<Watch>>) {
    let watch = Arc::new(Mutex::new(Watch::default()));
    let shared = Arc::clone(&watch);
    let yard = by_alias(move |line| {
        let on_line = line.clone();
        let wire = line.wire_with(move |_, frame| {
            let mut watch = shared.lock().unwrap();
            let mut off = std::mem::take(&mut watch.now);
            for datagram in datagrams(&mut frame.to_vec()) {
                let Some(moment) = Moment::of(datagram) else {
                    continue;
                };
                let number = watch.seen.len();
                watch.seen.push(moment);
                match watch.cut {
                    Some((at, Cut::Before)) if at == number => off = true,
                    Some((at, Cut::After)) if at == number => watch.now = true,
                    _ => {}
                }
            }
            if off {
                on_line.segment().device_mut(MIDDLE).unwrap().power_off();
            }
            Fate::Deliver
        });
        Network::builder().link(wire)
    });
    (yard, watch)
}

#[test]
fn the_power_may_go_at_every_step_of_a_replacement_and_the_next_call_comes_to_its_end() {
    use Moment::{Address, Download, Reload, State, Word};
    let (mut yard, watch) = watched();
    yard.is_exchanged(drive(2));
    *watch.lock().unwrap() = Watch::default();
    yard.nothing_may_happen();
    assert_eq!(yard.replace(2, &backup()).unwrap(), ANEW);
    yard.is_replaced("without interruption");
    assert_eq!(yard.image().unwrap().alias(), ALIAS);
    yard.nothing_has_happened();
    let steps = watch.lock().unwrap().seen.clone();
    let first = |moment| steps.iter().position(|seen| *seen == moment);
    let order = [
        Address,
        State(1),
        Word,
        Reload,
        State(2),
        Download(0x607D),
        Download(0x607F),
        Download(0x1010),
        Download(0x1C12),
        State(4),
        State(8),
    ];
    let places: Vec<_> = order.map(|moment| first(moment).unwrap()).to_vec();
    assert!(places.is_sorted(), "{places:?} of {steps:?}");

    let mut serial = 2;
    for cut in [Cut::Before, Cut::After] {
        for (at, step) in steps.iter().enumerate() {
            serial += 1;
            let what = format!("{cut:?} number {at}, {step:?}");
            yard.is_exchanged(drive(serial));
            yard.nothing_may_happen();
            let missed = yard.missed();
            *watch.lock().unwrap() = Watch {
                cut: Some((at, cut)),
                ..Watch::default()
            };
            let error = yard.replace(serial, &backup()).unwrap_err();
            *watch.lock().unwrap() = Watch::default();
            let failed = match error {
                NetworkError::WrongLine(table) => {
                    assert_eq!(table.0[0].verdict, LineVerdict::Missing, "{what}");
                    BringUpStep::Identity
                }
                other => fault(other).0,
            };
            assert_eq!(
                failed,
                step.fails_in(at == 1 && cut == Cut::After),
                "{what}"
            );
            // A word of an EEPROM cannot be written together with its checksum.
            let valid = yard.image().is_some();
            assert!(valid || *step == Word, "{what}: no valid image");
            assert!(yard.axis("z").status().lost, "{what}");
            yard.has_power_again();
            assert_ne!(yard.state(MIDDLE), AlState::Op, "{what}");

            let mut replaced = yard.replace(serial, &backup());
            if !valid {
                // It is whole again, and a drive loads it when it is switched on.
                assert_eq!(
                    yard.image().map(|image| image.alias()),
                    Some(ALIAS),
                    "{what}"
                );
                let (step, fault) = fault(replaced.unwrap_err());
                assert_eq!(step, BringUpStep::Alias, "{what}");
                assert!(
                    matches!(fault, DriveFault::NotInForce { .. }),
                    "{what}: {fault}"
                );
                yard.line.segment().device_mut(MIDDLE).unwrap().power_off();
                yard.has_power_again();
                replaced = yard.replace(serial, &backup());
            }
            assert_eq!(replaced.unwrap(), ANEW, "{what}");
            yard.is_replaced(&what);
            assert_eq!(yard.image().unwrap().alias(), ALIAS, "{what}");
            yard.rig.run_for(100 * MS);
            assert_eq!(yard.watched.seen(), Vec::<String>::new(), "{what}");
            assert_eq!(yard.missed(), missed, "{what}: of the first drive");
            yard.watched.disarm();
            // Stored, not only in force.
            yard.loses_power(50 * MS);
            assert_eq!(yard.held(), HELD, "{what}");
        }
    }
    yard.recover(1).unwrap();
    yard.works_again("z");
    yard.ends();
}

#[test]
fn an_alias_that_is_in_force_after_a_power_up_only_is_said_to_need_one() {
    let (mut yard, _) = watched();
    let mut new = drive(2);
    new.set_eeprom_reload(EepromReload::WithoutAlias);
    yard.is_exchanged(new);
    let (step, fault) = fault(yard.replace(2, &backup()).unwrap_err());
    assert_eq!(step, BringUpStep::Alias);
    assert!(
        matches!(
            fault,
            DriveFault::NotInForce {
                alias: ALIAS,
                got: 0
            }
        ),
        "{fault}"
    );
    assert_eq!(yard.state(MIDDLE), AlState::Init);
    yard.loses_power(50 * MS);
    assert_eq!(yard.replace(2, &backup()).unwrap(), ANEW);
    yard.is_replaced("after a power-up");
    yard.ends();
}

/// Also while its EEPROM is being written: that is brought to its end first.
#[test]
fn a_replacement_is_dropped_after_many_a_poll_and_the_next_one_comes_to_its_end() {
    let (mut yard, _) = watched();
    let (mut serial, mut polls) = (1, 0);
    loop {
        serial += 1;
        yard.is_exchanged(drive(serial));
        yard.nothing_may_happen();
        let net = yard.rig.net.take().unwrap();
        let done = {
            let backup = backup();
            let mut replacement = pin!(net.replace("z", serial, &backup));
            let mut context = Context::from_waker(Waker::noop());
            (0..=polls).any(|_| {
                let is_done = replacement.as_mut().poll(&mut context).is_ready();
                if !is_done {
                    assert!(yard.rig.bus.turn());
                }
                is_done
            })
        };
        yard.rig.net = Some(net);
        yard.nothing_has_happened();
        assert!(yard.image().is_some(), "after {polls} polls");
        if done {
            break;
        }
        assert_ne!(yard.state(MIDDLE), AlState::Op, "after {polls} polls");
        assert!(yard.axis("z").status().lost, "after {polls} polls");
        yard.nothing_may_happen();
        let again = yard.replace(serial, &backup());
        assert!(again.is_ok(), "after {polls} polls: {again:?}");
        yard.is_replaced("again");
        yard.nothing_has_happened();
        polls += 41;
    }
    assert!(polls > 400, "{polls}");
    yard.works_again("z");
    yard.ends();
}

#[test]
fn what_was_begun_with_one_drive_is_not_written_to_another() {
    let (mut yard, watch) = watched();
    yard.is_exchanged(drive(2));
    *watch.lock().unwrap() = Watch::default();
    yard.replace(2, &backup()).unwrap();
    let steps = watch.lock().unwrap().seen.clone();
    let word = steps.iter().position(|seen| *seen == Moment::Word).unwrap();
    // Each loses its power when its first word is written, which makes the checksum wrong.
    let mut broken = [3, 4].map(|serial| {
        yard.is_exchanged(drive(serial));
        *watch.lock().unwrap() = Watch {
            cut: Some((word, Cut::After)),
            ..Watch::default()
        };
        yard.replace(serial, &backup()).unwrap_err();
        *watch.lock().unwrap() = Watch::default();
        assert_eq!(yard.image(), None);
        let mut segment = yard.line.segment();
        std::mem::replace(segment.device_mut(MIDDLE).unwrap(), drive(0))
    });
    let eeprom = broken[0].eeprom().to_vec();
    yard.is_exchanged(std::mem::replace(&mut broken[0], drive(0)));
    let (step, fault) = fault(yard.replace(3, &backup()).unwrap_err());
    assert_eq!(step, BringUpStep::Alias);
    assert!(matches!(fault, DriveFault::NoImage(_)), "{fault}");
    assert_eq!(yard.line.segment().device(MIDDLE).unwrap().eeprom(), eeprom);
    // The last one that was begun is brought to its end.
    yard.is_exchanged(std::mem::replace(&mut broken[1], drive(0)));
    let (_, fault) = self::fault(yard.replace(4, &backup()).unwrap_err());
    assert!(matches!(fault, DriveFault::NotInForce { .. }), "{fault}");
    assert_eq!(yard.image().unwrap().alias(), ALIAS);
    yard.loses_power(50 * MS);
    assert_eq!(yard.replace(4, &backup()).unwrap(), ANEW);
    yard.works_again("z");
    yard.ends();
}
