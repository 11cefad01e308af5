//! Where in the line a device is that was without power: it has lost its station address, and others may be missing.
//!
//! What is left of a line has the order that it had. Devices that have kept their address are known by it; for the others the
//! identity decides, down to the serial number, and the order where several are alike.

use crate::{
    bus::{
        error::{BringUpStep, DriveFault, NetworkError, RegisterError},
        expected::{DevicePlace, Expected, LineMismatch, LineRow, Present, Verdict},
        line::{FIRST_STATION, STATION_ADDRESS, count},
        requests::{eeprom, registers::Registers},
    },
    coe::DriveId,
    sii::Identity,
};

/// The first of the station addresses that nameless devices have while it is looked who they are: behind those of a line.
const PROVISIONAL: u16 = 0x2000;
/// How often the line is looked at again when it has changed meanwhile.
const TRIES: usize = 3;

/// A device of the line as it is now.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FoundAs {
    /// It has kept its address: this is its place at the start.
    Known(usize),
    /// It has none of the line's, and is this one.
    Nameless(Identity),
}

/// Gives the device that had this place at the start its station address again; tells where it is now.
pub(in crate::bus) async fn find(
    registers: &Registers,
    line: &[DriveId],
    wanted: &DriveId,
) -> Result<u16, NetworkError> {
    for _ in 0..TRIES {
        let mut names = names(registers, line.len()).await?;
        let seen = identify(registers, &names).await?;
        let position = choose(line, wanted, &seen)?;
        let name = FIRST_STATION.wrapping_add(wanted.position);
        give_name(registers, position, name).await?;
        // Who came or went meanwhile has moved the positions.
        if let Some(given) = names.get_mut(usize::from(position)) {
            *given = Some(wanted.position.into());
        }
        let now = self::names(registers, line.len()).await?;
        if now == names {
            return Ok(position);
        }
        for (position, _) in (0..)
            .zip(now)
            .filter(|(_, now)| *now == Some(wanted.position.into()))
        {
            give_name(registers, position, 0).await?;
        }
    }
    Err(NetworkError::Drive {
        drive: wanted.clone(),
        step: BringUpStep::Identity,
        error: Box::new(DriveFault::Register(RegisterError::NotAnswered)),
    })
}

/// Of each device that is there: which place it had at the start, if its address tells.
async fn names(registers: &Registers, at_start: usize) -> Result<Vec<Option<usize>>, NetworkError> {
    let mut names = Vec::new();
    for position in 0..count(registers).await? {
        match registers.read_at(position, STATION_ADDRESS).await {
            Ok(address) => {
                let place = u16::from_le_bytes(address).checked_sub(FIRST_STATION);
                names.push(place.map(usize::from).filter(|place| *place < at_start));
            }
            // It was there when they were counted.
            Err(RegisterError::NotAnswered) => break,
            Err(error) => return Err(NetworkError::Line(error)),
        }
    }
    Ok(names)
}

/// Asks those without a name who they are.
async fn identify(
    registers: &Registers,
    names: &[Option<usize>],
) -> Result<Vec<FoundAs>, NetworkError> {
    let mut seen = Vec::with_capacity(names.len());
    for (position, name) in (0..).zip(names) {
        seen.push(match name {
            Some(place) => FoundAs::Known(*place),
            None => {
                let station = PROVISIONAL.wrapping_add(position);
                give_name(registers, position, station).await?;
                let identity = eeprom::identity(registers, station).await;
                give_name(registers, position, 0).await?;
                // One that cannot be read is none of the line's.
                FoundAs::Nameless(identity.unwrap_or_default())
            }
        });
    }
    Ok(seen)
}

async fn give_name(registers: &Registers, position: u16, station: u16) -> Result<(), NetworkError> {
    let station = station.to_le_bytes();
    let given = registers.write_at(position, STATION_ADDRESS, &station);
    given.await.map_err(NetworkError::Line)
}

/// Which of the devices that are there is the wanted one.
fn choose(line: &[DriveId], wanted: &DriveId, seen: &[FoundAs]) -> Result<u16, NetworkError> {
    let expected: Vec<_> = line.iter().map(|device| device.identity).collect();
    let place = usize::from(wanted.position);
    let candidates = candidates(&expected, place, seen);
    let verdict = match candidates.as_slice() {
        &[(only, false)] => return Ok(to_position(only)),
        [] => {
            let mut behind = seen.iter().enumerate().filter(|(_, seen)| match seen {
                FoundAs::Known(known) => *known < place,
                FoundAs::Nameless(_) => false,
            });
            // What stands where it would be the next one.
            let at = behind.next_back().map_or(0, |(at, _)| at + 1);
            match seen.get(at) {
                Some(FoundAs::Nameless(identity)) if *identity != wanted.identity => {
                    return Err(mismatch(wanted, Some((at, *identity)), Verdict::Different));
                }
                _ => Verdict::Missing,
            }
        }
        several => Verdict::NotUnique {
            positions: several.iter().map(|(at, _)| to_position(*at)).collect(),
        },
    };
    Err(mismatch(wanted, None, verdict))
}

/// The table of a line of which only the wanted device is looked at.
pub(in crate::bus) fn mismatch(
    wanted: &DriveId,
    found: Option<(usize, Identity)>,
    verdict: Verdict,
) -> NetworkError {
    let Identity {
        vendor,
        product,
        revision,
        serial,
    } = wanted.identity;
    let expected = Expected::new(vendor, product).revision(revision);
    let expected = expected.serial(serial).named(wanted.name.clone());
    let found = found.map(|(at, identity)| Present {
        id: DriveId {
            position: to_position(at),
            name: String::new(),
            identity,
        },
        alias: None,
    });
    let place = DevicePlace::Position(wanted.position);
    NetworkError::WrongLine(LineMismatch(vec![LineRow {
        position: Some(wanted.position),
        expected: Some((place, expected)),
        found,
        verdict,
    }]))
}

/// The nameless devices that can be the one that had this place, if what is there is a part of the line in its order; each
/// with whether it can be that of another place as well. Devices that no place of the line had are left out.
fn candidates(line: &[Identity], place: usize, seen: &[FoundAs]) -> Vec<(usize, bool)> {
    let own: Vec<_> = seen
        .iter()
        .enumerate()
        .filter(|(_, seen)| line.iter().enumerate().any(|(at, is)| seen.is(at, is)))
        .collect();
    let others = || (0..line.len()).filter(|other| *other != place);
    (0..own.len())
        .filter(|number| can_be(&own, *number, line, place))
        .filter_map(|number| {
            let or_another = others().any(|other| can_be(&own, number, line, other));
            Some((own.get(number)?.0, or_another))
        })
        .collect()
}

/// Whether the device with this number among those that are there can be the nameless one that had this place.
fn can_be(own: &[(usize, &FoundAs)], number: usize, line: &[Identity], place: usize) -> bool {
    let (Some((_, FoundAs::Nameless(identity))), Some(before), Some(behind)) =
        (own.get(number), own.get(..number), own.get(number + 1..))
    else {
        return false;
    };
    let (Some(wanted), Some(front), Some(back)) =
        (line.get(place), line.get(..place), line.get(place + 1..))
    else {
        return false;
    };
    identity == wanted && fit(before, 0, front) && fit(behind, place + 1, back)
}

/// Whether these are devices of this part of a line, which begins with place `from`, in its order; some may be missing.
fn fit(seen: &[(usize, &FoundAs)], from: usize, line: &[Identity]) -> bool {
    let mut places = (from..).zip(line);
    seen.iter()
        .all(|(_, seen)| places.any(|(place, identity)| seen.is(place, identity)))
}

impl FoundAs {
    fn is(&self, place: usize, identity: &Identity) -> bool {
        match self {
            Self::Known(known) => *known == place,
            Self::Nameless(own) => own == identity,
        }
    }
}

fn to_position(at: usize) -> u16 {
    u16::try_from(at).unwrap_or(u16::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one(product: u32, serial: u32) -> Identity {
        Identity {
            vendor: 1,
            product,
            revision: 3,
            serial,
        }
    }

    const NOBODY: [(usize, bool); 0] = [];

    #[test]
    fn between_two_that_are_known_the_nameless_one_is_the_one_that_is_missing_there() {
        let line = [one(1, 0), one(2, 0), one(2, 0), one(2, 0)];
        let seen = [
            FoundAs::Known(0),
            FoundAs::Known(1),
            FoundAs::Nameless(one(2, 0)),
            FoundAs::Known(3),
        ];
        assert_eq!(candidates(&line, 2, &seen), [(2, false)]);
        assert_eq!(candidates(&line, 1, &seen), NOBODY, "it is known");
        // The first is missing, so that all have moved up.
        assert_eq!(candidates(&line, 2, &seen[1..]), [(1, false)]);
    }

    #[test]
    fn all_without_a_name_are_told_apart_by_their_order_if_all_are_there() {
        let line = [one(2, 0), one(2, 0), one(3, 0), one(2, 0)];
        let seen = line.map(FoundAs::Nameless);
        for place in 0..4 {
            assert_eq!(candidates(&line, place, &seen), [(place, false)]);
        }
    }

    #[test]
    fn of_two_that_are_alike_and_one_missing_nobody_knows_which_one_is_there() {
        let line = [one(2, 0), one(2, 0), one(2, 0)];
        let seen = [FoundAs::Known(0), FoundAs::Nameless(one(2, 0))];
        assert_eq!(candidates(&line, 1, &seen), [(1, true)]);
        assert_eq!(candidates(&line, 2, &seen), [(1, true)]);
        // A serial number tells.
        let line = [one(2, 0), one(2, 1), one(2, 2)];
        let seen = [FoundAs::Known(0), FoundAs::Nameless(one(2, 2))];
        assert_eq!(candidates(&line, 1, &seen), NOBODY);
        assert_eq!(candidates(&line, 2, &seen), [(1, false)]);
    }

    #[test]
    fn a_stranger_is_left_out_wherever_it_stands() {
        let line = [one(1, 0), one(2, 7), one(3, 0)];
        let seen = [
            FoundAs::Known(0),
            FoundAs::Nameless(one(9, 9)),
            FoundAs::Nameless(one(2, 7)),
            FoundAs::Known(2),
        ];
        assert_eq!(candidates(&line, 1, &seen), [(2, false)]);
        let other_serial = [
            FoundAs::Known(0),
            FoundAs::Nameless(one(2, 8)),
            FoundAs::Known(2),
        ];
        assert_eq!(candidates(&line, 1, &other_serial), NOBODY);
    }
}
