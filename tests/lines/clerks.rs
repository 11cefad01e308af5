//! The SDO traffic of a program, and what each answer must be.

use servocrab::coe::{DriveError, SdoHandle, information::ListKind, obj};

use crate::{
    program::{Common, MS, SDO_LIMIT, variant},
    random::Random,
};

/// A drive with a mailbox, as its clerks know it.
#[derive(Clone)]
pub struct Desk {
    pub sdo: SdoHandle,
    /// Its position in the line, and its number among the drives.
    pub position: u16,
    pub drive: usize,
    pub product: u32,
    pub name: String,
    pub has_note: bool,
}

impl Desk {
    fn error_names_the_drive(&self, error: &DriveError) {
        assert_eq!(error.drive.position, self.position, "{error}");
        assert_eq!(error.drive.identity.product, self.product, "{error}");
    }
}

/// Reads what never changes, and reads and writes one object.
pub async fn clerk(common: Common, desk: Desk, number: u64) {
    let mut random = Random::new(common.seed ^ (u64::from(desk.position) << 8 | number) << 32);
    let mut last = 1_100_000;
    while !common.ending.get() {
        common.pause(&mut random, 60).await;
        let what = format!("{} of drive {}", "a transfer", desk.position);
        let written = (number == 0).then_some(&mut last);
        let transfer = one_transfer(&common, &desk, &mut random, written);
        // Who goes away leaves the mailbox in order.
        if random_drop(&mut Random::new(common.clock.now().as_nanos() as u64)) {
            common.clock.within(2 * MS, transfer).await;
            common.count("sdo: dropped");
        } else {
            common.in_time(&what, SDO_LIMIT, transfer).await;
        }
    }
}

fn random_drop(random: &mut Random) -> bool {
    random.once_in(8)
}

async fn one_transfer(
    common: &Common,
    desk: &Desk,
    random: &mut Random,
    written: Option<&mut u32>,
) {
    let begun = common.clock.now();
    let kind = random.below(6);
    let failed = match (kind, written) {
        (0, _) => {
            let read = desk.sdo.read(obj::PRODUCT_CODE).await;
            if let Ok(read) = &read {
                assert!(
                    !common.honest || *read == desk.product,
                    "1018h:02: {read:08X}"
                );
            }
            read.err()
        }
        (1, _) => {
            let read = desk.sdo.read_bytes(0x1008, 0).await;
            if let Ok(read) = &read {
                let read = String::from_utf8_lossy(read);
                assert!(!common.honest || read == desk.name, "1008h: {read}");
            }
            read.err()
        }
        (2 | 3, _) => {
            let read = desk.sdo.read(obj::QUICK_STOP_DECELERATION).await;
            if let Ok(read) = read
                && common.honest
            {
                let held = common.judge.held(desk.drive, begun, read);
                assert!(held, "drive {}: 6085h was never {read}", desk.position);
            }
            read.err()
        }
        (4, Some(last)) => {
            *last += 1;
            let value = *last;
            let written = desk.sdo.write(obj::QUICK_STOP_DECELERATION, value).await;
            let had_power = common
                .without_power
                .borrow()
                .get(&desk.drive)
                .is_none_or(|at| *at < begun);
            if written.is_ok() && common.honest && had_power {
                let held = common.judge.held(desk.drive, begun, value);
                assert!(held, "drive {}: 6085h never became {value}", desk.position);
            }
            written.err()
        }
        _ => {
            let lists = desk.sdo.object_list(ListKind::All).await;
            if let Ok(list) = &lists {
                assert!(!common.honest || list.contains(&0x6041), "{list:04X?}");
            }
            lists.err()
        }
    };
    match failed {
        None => common.count("sdo: ok"),
        Some(error) => {
            desk.error_names_the_drive(&error);
            common.count(format!("sdo: {}", variant(&error.error)));
        }
    }
}

/// Writes and reads a text that takes segments.
pub async fn writer(common: Common, desk: Desk) {
    let mut random = Random::new(common.seed ^ u64::from(desk.position) << 40);
    // What the object may hold: of a write that failed nobody knows whether it took effect.
    let mut possible: Vec<Vec<u8>> = vec![Vec::new()];
    while !common.ending.get() {
        common.pause(&mut random, 150).await;
        let begun = common.clock.now();
        if random.once_in(2) {
            let letter = b'a' + random.below(26) as u8;
            let text = vec![letter; random.between(1, 3_500) as usize];
            let written = desk.sdo.write_bytes(0x5F00, 0, text.clone());
            let written = common.in_time("a note", 2 * SDO_LIMIT, written).await;
            match written {
                Ok(()) => {
                    let lost = common.without_power.borrow().get(&desk.drive).copied();
                    possible.clear();
                    if lost.is_some_and(|at| at >= begun) {
                        possible.push(Vec::new());
                    }
                    common.count("note: written");
                }
                Err(error) => {
                    desk.error_names_the_drive(&error);
                    common.count(format!("note: {}", variant(&error.error)));
                }
            }
            possible.push(text);
        } else {
            let read = desk.sdo.read_bytes(0x5F00, 0);
            let read = common.in_time("the note", 2 * SDO_LIMIT, read).await;
            match read {
                Ok(read) => {
                    let power = common.without_power.borrow().contains_key(&desk.drive);
                    let fits = possible.contains(&read) || power && read.is_empty();
                    let (is, begin) = (read.len(), read.first());
                    assert!(
                        !common.honest || fits,
                        "drive {}: a note of {is} times {begin:?} that was never written",
                        desk.position
                    );
                    common.count("note: read");
                }
                Err(error) => {
                    desk.error_names_the_drive(&error);
                    common.count(format!("note: {}", variant(&error.error)));
                }
            }
        }
    }
}
