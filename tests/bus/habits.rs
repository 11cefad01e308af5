//! From power-on to OP, and on in OP, with drives of bad habits: each mail of a bring-up refused, answered late, or between
//! emergencies; each AL state refused, left for PREOP, or lost later.

use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

use servocrab::{
    AxisConfig, DriveConfig, Network, NetworkError, Outcome, Referencing,
    bus::{AlError, AlState as State, BringUpStep, DriveFault, NetworkEvent},
    coe::{ObjectAddress, SdoError, obj},
    drives,
};
use servocrab_sim::{Abort, AlState, Device, Habits, Segment, personality, personality::Servo};

use crate::rig::{Line, Rig, is_cyclic};

const MS: Duration = Duration::from_millis(1);

/// Another mapping than the drive has at power-up, in both directions.
fn config() -> DriveConfig {
    DriveConfig::new(drives::generic()).axis(
        AxisConfig::new("x")
            .map_output(obj::QUICK_STOP_DECELERATION)
            .map_input(obj::FOLLOWING_ERROR_ACTUAL)
            .referencing(Referencing::UnreferencedMovesAllowed),
    )
}

/// What a MainDevice asked of the drive.
#[derive(Clone, Debug, PartialEq)]
enum Asked {
    /// An SDO request: the object, and whether it is written.
    Sdo(ObjectAddress, bool),
    MailboxMessage,
    Al(u16),
}

/// A drive, and everything that is asked of it.
struct Bench {
    line: Line,
    asked: Arc<Mutex<Vec<Asked>>>,
}

impl Bench {
    fn new(device: Device, habits: Habits) -> Self {
        let line = Line::new(Segment::new().with(device));
        line.segment().device_mut(0).unwrap().set_habits(habits);
        Self {
            line,
            asked: Arc::default(),
        }
    }

    fn start(&self) -> Result<Rig, NetworkError> {
        let asked = Arc::clone(&self.asked);
        let mailbox = self.line.segment().devices()[0]
            .description()
            .mailbox
            .unwrap()
            .out;
        let wire = self.line.spoiled_wire(move |frame| {
            asked.lock().unwrap().extend(requests(frame, mailbox));
        });
        Rig::start(Network::builder().link(wire).drive(0, config()))
    }

    fn asked(&self) -> Vec<Asked> {
        self.asked.lock().unwrap().clone()
    }

    /// The messages among it.
    fn messages(&self) -> Vec<Asked> {
        let mut asked = self.asked();
        asked.retain(|asked| !matches!(asked, Asked::Al(_)));
        asked
    }

    fn state(&self) -> AlState {
        self.line.segment().devices()[0].al_state()
    }
}

/// What the datagrams of a frame write to a mailbox and to AL control.
fn requests(frame: &[u8], (start, length): (u16, u16)) -> Vec<Asked> {
    let word = |at: usize| u16::from_le_bytes([frame[at], frame[at + 1]]);
    let (mut at, mut more, mut asked) = (16, true, Vec::new());
    while more {
        let (command, register, size) = (frame[at], word(at + 4), word(at + 6));
        more = size & 0x8000 != 0;
        let data = at + 10;
        // FPWR.
        if command == 5 && register == 0x0120 {
            asked.push(Asked::Al(word(data)));
        }
        if command == 5 && (start..start + length).contains(&register) && word(data) > 0 {
            let is_sdo = frame[data + 7] == 0x20 && matches!(frame[data + 8] >> 5, 1 | 2);
            asked.push(if is_sdo {
                let object = ObjectAddress::new(word(data + 9), frame[data + 11]);
                Asked::Sdo(object, frame[data + 8] >> 5 == 1)
            } else {
                Asked::MailboxMessage
            });
        }
        at = data + usize::from(size & 0x07FF) + 2;
    }
    asked
}

/// Moves the axis once, and shuts down.
fn moves(bench: &Bench, mut rig: Rig) {
    assert_eq!(bench.state(), AlState::Op);
    let moved = rig.moved("x", 1_000);
    assert!(matches!(moved, Outcome::Reached { .. }), "{moved:?}");
    rig.shutdown();
}

fn refused(result: Result<Rig, NetworkError>) -> (String, BringUpStep, DriveFault) {
    match result {
        Ok(_) => panic!("it was started"),
        Err(error) => {
            let text = error.to_string();
            match error {
                NetworkError::Drive { drive, step, error } => {
                    assert_eq!(drive.position, 0);
                    assert!(text.contains(&drive.to_string()), "{text}");
                    (text, step, *error)
                }
                other => panic!("no fault of a drive: {other}"),
            }
        }
    }
}

/// Every mail of a bring-up that nothing disturbs.
fn messages_of_a_bring_up() -> Vec<Asked> {
    let bench = Bench::new(personality::generic(), Habits::default());
    bench.start().unwrap().shutdown();
    bench.messages()
}

fn is_of_the_mapping(object: ObjectAddress) -> bool {
    matches!(object.index, 0x1C12 | 0x1C13 | 0x1600..=0x17FF | 0x1A00..=0x1BFF)
}

#[test]
fn a_drive_without_sdo_information_comes_up_and_moves_and_says_so_in_op() {
    for refuses_information_by_mailbox in [false, true] {
        let habits = Habits {
            refuses_information_by_mailbox,
            ..Habits::default()
        };
        let bench = Bench::new(Servo::generic().without_sdo_information().build(), habits);
        let mut rig = bench.start().unwrap();
        let sdo = rig.net().sdo(0).unwrap();
        let error = rig.until(sdo.dictionary()).unwrap_err().error;
        assert!(matches!(error, SdoError::NotSupported { .. }), "{error}");
        assert_eq!(rig.until(sdo.read(obj::PRODUCT_CODE)).unwrap(), 0x4453_0402);
        moves(&bench, rig);
    }
}

#[test]
fn each_request_of_a_bring_up_that_the_drive_aborts_is_named_and_nothing_is_written_behind_it() {
    let all = messages_of_a_bring_up();
    let is_write =
        |asked: &Asked| matches!(asked, Asked::Sdo(object, true) if is_of_the_mapping(*object));
    let first_write = all.iter().position(is_write).unwrap();
    let (mut writes, mut tolerated) = (0, Vec::new());
    for (number, asked) in all.iter().enumerate() {
        let &Asked::Sdo(object, written) = asked else {
            panic!("{asked:?} in a bring-up");
        };
        let habits = Habits {
            refuses: Some((number as u64, Abort::State)),
            ..Habits::default()
        };
        let bench = Bench::new(personality::generic(), habits);
        let result = bench.start();
        if let Ok(rig) = result {
            // Three values of 6007h stop an axis: another one is taken then. What of the mapping cannot be read before it
            // is written counts as different. What is not read by complete access is read one by one.
            let another = written && object.index == 0x6007;
            let whole = !written && object.subindex == 0;
            let before = is_of_the_mapping(object) && (number < first_write || whole);
            assert!(
                another || before || !is_of_the_mapping(object),
                "{object} was refused"
            );
            if before {
                moves(&bench, rig);
                continue;
            }
            tolerated.push(object.to_string());
            rig.shutdown();
            continue;
        }
        let (text, step, _) = refused(result);
        for part in [&object.to_string(), "08000022h", "state"] {
            assert!(text.contains(part), "{part} is not in: {text}");
        }
        assert_eq!(
            is_of_the_mapping(object),
            step == BringUpStep::Mapping,
            "{text}"
        );
        writes += u32::from(is_of_the_mapping(object));
        let messages = bench.messages();
        assert_eq!(messages[..=number], all[..=number], "{text}");
        let behind = &messages[number + 1..];
        assert!(
            !behind
                .iter()
                .any(|asked| matches!(asked, Asked::Sdo(_, true))),
            "{text}"
        );
        let up = |asked: &Asked| matches!(asked, Asked::Al(state) if state & 0x0F > 2);
        // What motion needs is read in SAFEOP, but for what the outputs overwrite.
        let overwritten = matches!(object.index, 0x6081 | 0x6083..=0x6085);
        let in_safe_op = !is_of_the_mapping(object) && !overwritten;
        assert_eq!(bench.asked().iter().any(up), in_safe_op, "{text}");
        assert!(bench.state() <= AlState::PreOp, "{text}");
    }
    assert!(writes > 15, "{writes} writes of the mapping");
    assert!(tolerated.len() < 12, "{tolerated:?}");
}

#[test]
fn each_message_of_a_bring_up_may_come_late_and_one_that_comes_too_late_is_named() {
    let all = messages_of_a_bring_up();
    for (number, asked) in all.iter().enumerate() {
        let late = |time| Habits {
            late: Some((number as u64, time)),
            ..Habits::default()
        };
        // A reply has a second.
        let bench = Bench::new(personality::generic(), late(100 * MS));
        let rig = bench.start();
        rig.unwrap_or_else(|error| panic!("{asked:?}: {error}"))
            .shutdown();
        assert_eq!(
            bench.messages()[..all.len()],
            all,
            "nothing was asked again"
        );

        // Every fourth of them: a second is long, even in virtual time.
        if number % 4 != 0 {
            continue;
        }
        let bench = Bench::new(personality::generic(), late(1_100 * MS));
        let (text, ..) = refused(bench.start());
        let Asked::Sdo(object, _) = asked else {
            panic!("{asked:?} in a bring-up");
        };
        assert!(
            text.contains(&object.to_string()),
            "{object} is not in: {text}"
        );
        assert!(text.contains("1s"), "{text}");
        assert_eq!(
            bench.messages().len(),
            number + 1,
            "nothing is asked behind it: {text}"
        );
        assert!(bench.state() <= AlState::PreOp, "{text}");
        // It is not broken by that.
        let rig = bench
            .start()
            .unwrap_or_else(|error| panic!("once more: {error}"));
        rig.shutdown();
    }
}

#[test]
fn emergencies_around_every_reply_of_a_bring_up_and_a_move_harm_neither() {
    let habits = Habits {
        emergencies: true,
        ..Habits::default()
    };
    let bench = Bench::new(personality::generic(), habits);
    let rig = bench.start().unwrap();
    moves(&bench, rig);
    let sent = bench.line.segment().devices()[0].habitual_emergencies();
    assert!(
        sent as usize >= 2 * messages_of_a_bring_up().len(),
        "{sent}"
    );
}

/// A code of the maker's, with no other meaning.
const CODE: u16 = 0x8001;

#[test]
fn a_drive_that_drops_when_it_is_asked_for_a_state_is_quoted_with_the_state_and_the_code() {
    let asked = [(AlState::SafeOp, State::SafeOp), (AlState::Op, State::Op)];
    for (asked, step) in asked {
        for (falls_to, seen) in [(AlState::PreOp, State::PreOp), (AlState::Init, State::Init)] {
            let habits = Habits {
                falls: Some((asked, falls_to, CODE)),
                ..Habits::default()
            };
            let bench = Bench::new(personality::generic(), habits);
            let (text, at, fault) = refused(bench.start());
            assert_eq!(at, BringUpStep::State(step), "{text}");
            let DriveFault::Al(AlError::Refused(status)) = fault else {
                panic!("{text}");
            };
            assert_eq!((status.state, status.error), (seen, Some(CODE)), "{text}");
            for part in ["8001h", &seen.to_string()] {
                assert!(text.contains(part), "{part} is not in: {text}");
            }
            assert!(bench.state() <= falls_to, "{text}");
        }
    }
}

#[test]
fn a_drive_that_drops_by_itself_on_its_way_from_safe_op_to_op_is_quoted_with_its_code() {
    // In each of the exchanges that go ahead of the request for OP, and those right behind it.
    let (mut quoted, mut told) = (0, 0);
    for exchanges in 1..8 {
        for (falls_to, seen) in [
            (AlState::Init, State::Init),
            (AlState::PreOp, State::PreOp),
            (AlState::SafeOp, State::SafeOp),
        ] {
            let line = Line::new(Segment::new().with(personality::generic()));
            let (falling, count) = (line.clone(), Mutex::new(0));
            let wire = line.spoiled_wire(move |frame| {
                let mut count = count.lock().unwrap();
                *count += u32::from(is_cyclic(frame));
                if *count == exchanges {
                    *count += 1;
                    let mut segment = falling.segment();
                    segment.device_mut(0).unwrap().fall_to(falls_to, CODE);
                }
            });
            let result = Rig::start(Network::builder().link(wire).drive(0, config()));
            let status = match result {
                Err(_) => {
                    let (text, step, fault) = refused(result);
                    let DriveFault::Al(AlError::Refused(status)) = fault else {
                        panic!("exchange {exchanges}, {seen}: {text}");
                    };
                    assert_eq!(step, BringUpStep::State(State::Op), "{text}");
                    assert!(text.contains("8001h"), "{text}");
                    assert!(line.segment().devices()[0].al_state() <= falls_to);
                    quoted += 1;
                    status
                }
                // It was in OP by then.
                Ok(mut rig) => {
                    rig.run_for(250 * MS);
                    let event = rig.net().events().try_next();
                    let Some(NetworkEvent::LeftOp { status, .. }) = event else {
                        panic!("exchange {exchanges}, {seen}: {event:?}");
                    };
                    rig.shutdown();
                    told += 1;
                    status
                }
            };
            let what = format!("exchange {exchanges}, {seen}");
            assert_eq!((status.state, status.error), (seen, Some(CODE)), "{what}");
        }
    }
    // In INIT the mailbox is silent: what only motion needs cannot be read any more.
    assert!(quoted >= 6 && told >= 12, "{quoted} quoted, {told} told");
}

#[test]
fn a_drive_that_drops_in_op_is_reported_with_its_state_and_code_and_its_axes_are_lost() {
    let falls = [
        (AlState::SafeOp, State::SafeOp),
        (AlState::PreOp, State::PreOp),
        (AlState::Init, State::Init),
    ];
    for (falls_to, seen) in falls {
        let bench = Bench::new(personality::generic(), Habits::default());
        let mut rig = bench.start().unwrap();
        let axis = rig.net().axis("x").unwrap();
        rig.until(axis.enable()).unwrap();
        let events = rig.net().events();
        rig.run_for(20 * MS);
        assert_eq!(events.try_next(), None);
        bench
            .line
            .segment()
            .device_mut(0)
            .unwrap()
            .fall_to(falls_to, CODE);
        rig.run_for(250 * MS);
        let mut told = Vec::new();
        while let Some(event) = events.try_next() {
            told.push(event);
        }
        let left = told.iter().find_map(|event| match event {
            NetworkEvent::LeftOp { drive, status } => Some((drive.position, *status)),
            _ => None,
        });
        let (position, status) = left.unwrap_or_else(|| panic!("{seen}: {told:?}"));
        assert_eq!(
            (position, status.state, status.error),
            (0, seen, Some(CODE))
        );
        let status = axis.status();
        assert!(status.lost, "{seen}");
        // Below SAFEOP a drive updates no inputs, and its memory answers all the same.
        assert_eq!(status.answered, seen == State::SafeOp, "{seen}");
        assert_eq!(
            status.age > 200,
            seen != State::SafeOp,
            "{seen}: {status:?}"
        );
        rig.shutdown();
    }
}

/// The program before was killed, and its drive fell by its watchdog. Its processor looks at AL control every few milliseconds.
#[test]
fn a_drive_that_is_slow_to_acknowledge_its_error_comes_up_and_is_led_back_at_the_first_try() {
    for delay in [MS / 5, MS, 5 * MS, 50 * MS] {
        let habits = Habits {
            al_delay: delay,
            ..Habits::default()
        };
        let line = Line::new(Segment::new().with(personality::generic()));
        let falls = || {
            let mut segment = line.segment();
            segment.device_mut(0).unwrap().fall_to_safe_op(0x001B);
        };
        let start = |begin| {
            let builder = Network::builder().link(line.wire_from(begin));
            Rig::start(builder.drive(0, config()))
                .unwrap_or_else(|error| panic!("{delay:?}: {error}"))
        };
        let killed = start(Duration::ZERO);
        let end = killed.bus.now();
        drop((killed.bus, killed.net));
        falls();
        line.segment().device_mut(0).unwrap().set_habits(habits);
        let mut rig = start(end);
        falls();
        rig.run_for(300 * MS);
        rig.recover(0)
            .unwrap_or_else(|error| panic!("{delay:?}: {error}"));
        assert_eq!(line.segment().devices()[0].al_state(), AlState::Op);
        rig.shutdown();
    }
}
