//! The line as the program expects it, beside the one that is there.

use std::{borrow::Cow, fmt};

use crate::{
    coe::{DriveId, value::column_width},
    sii::Identity,
};

/// Where a device is to be found in the line.
///
/// A number is a position:
///
/// ```
/// use servocrab::bus::DevicePlace;
/// assert_eq!(DevicePlace::from(2), DevicePlace::Position(2));
/// assert_eq!(DevicePlace::Alias(7).to_string(), "alias 7");
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub enum DevicePlace {
    /// At this position; the first SubDevice is 0.
    Position(u16),
    /// Wherever the one device with this configured station alias (register 0012h, word 4 of the SII) stands.
    Alias(u16),
    /// Wherever the one device stands that says this by explicit device identification (ETG.1020): it is asked by bit 5 of AL control
    /// 0120h, and answers in 0134h.
    Identification(u16),
    /// The same, of devices whose ESI names a register for it (`IdentificationAdo`).
    IdentificationAt {
        /// The register.
        register: u16,
        /// What stands there.
        id: u16,
    },
    /// Wherever the one device of this kind stands.
    Identity {
        /// The vendor ID.
        vendor: u32,
        /// The product code.
        product: u32,
        /// The serial number, where there are several of the kind.
        serial: Option<u32>,
    },
}

impl DevicePlace {
    /// Whether it is a number that devices have to which none was given.
    pub(super) const fn is_nobodys(self) -> bool {
        matches!(
            self,
            Self::Alias(0) | Self::Identification(0) | Self::IdentificationAt { id: 0, .. }
        )
    }
}

impl From<u16> for DevicePlace {
    fn from(position: u16) -> Self {
        Self::Position(position)
    }
}

/// Where a device was found at the start.
impl From<&DriveId> for DevicePlace {
    fn from(device: &DriveId) -> Self {
        Self::Position(device.position)
    }
}

impl fmt::Display for DevicePlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Position(position) => write!(f, "position {position}"),
            Self::Alias(alias) => write!(f, "alias {alias}"),
            Self::Identification(id) => write!(f, "identification {id}"),
            Self::IdentificationAt { register, id } => {
                write!(f, "identification {id} in register {register:04X}h")
            }
            Self::Identity {
                vendor,
                product,
                serial,
            } => {
                write!(f, "identity {vendor:08X}h:{product:08X}h")?;
                serial.map_or(Ok(()), |serial| write!(f, ", serial {serial:08X}h"))
            }
        }
    }
}

/// What a device is expected to be. What is not said of it may be anything.
///
/// ```
/// use servocrab::bus::Expected;
/// let coupler = Expected::new(0x2, 0x044C_2C52).named("EK1100");
/// assert_eq!(coupler.to_string(), "EK1100 (00000002h:044C2C52h)");
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Expected {
    pub(super) name: Cow<'static, str>,
    pub(super) vendor: Option<u32>,
    pub(super) product: Option<u32>,
    pub(super) revision: Option<u32>,
    pub(super) serial: Option<u32>,
}

impl Expected {
    /// A device of this vendor with this product code.
    #[must_use]
    pub const fn new(vendor: u32, product: u32) -> Self {
        Self {
            name: Cow::Borrowed(""),
            vendor: Some(vendor),
            product: Some(product),
            revision: None,
            serial: None,
        }
    }

    /// Any device.
    #[must_use]
    pub const fn any() -> Self {
        Self {
            name: Cow::Borrowed(""),
            vendor: None,
            product: None,
            revision: None,
            serial: None,
        }
    }

    /// What it is called in messages.
    #[must_use]
    pub fn named(mut self, name: impl Into<Cow<'static, str>>) -> Self {
        self.name = name.into();
        self
    }

    /// Of this revision alone.
    #[must_use]
    pub const fn revision(mut self, revision: u32) -> Self {
        self.revision = Some(revision);
        self
    }

    /// The one with this serial number.
    #[must_use]
    pub const fn serial(mut self, serial: u32) -> Self {
        self.serial = Some(serial);
        self
    }

    /// Whether a device with this identity is the one.
    #[must_use]
    pub fn matches(&self, identity: &Identity) -> bool {
        let is = |expected: Option<u32>, got| expected.is_none_or(|expected| expected == got);
        is(self.vendor, identity.vendor)
            && is(self.product, identity.product)
            && is(self.revision, identity.revision)
            && is(self.serial, identity.serial)
    }

    /// Whether it can be distinguished from other devices.
    const fn says_something(&self) -> bool {
        self.vendor.is_some() || self.product.is_some() || self.serial.is_some()
    }
}

impl fmt::Display for Expected {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let number = |number: Option<u32>| {
            number.map_or_else(|| "any".into(), |number| format!("{number:08X}h"))
        };
        let mut text = match (self.vendor, self.product) {
            (None, None) => String::from("any device"),
            (vendor, product) => format!("{}:{}", number(vendor), number(product)),
        };
        for (what, value) in [("revision", self.revision), ("serial", self.serial)] {
            if let Some(value) = value {
                text += &format!(", {what} {value:08X}h");
            }
        }
        if self.name.is_empty() {
            f.write_str(&text)
        } else {
            write!(f, "{} ({text})", self.name)
        }
    }
}

/// A device that is there.
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub struct Present {
    /// Its position, its name and what it says it is.
    pub id: DriveId,
    /// Its configured station alias and its identification, where these were read: they are when a device is expected by one.
    pub numbers: Vec<DevicePlace>,
}

impl Present {
    /// Whether the device is the one that is meant by this, wherever it stands.
    pub(super) fn says(&self, place: DevicePlace) -> bool {
        let identity = &self.id.identity;
        match place {
            DevicePlace::Position(_) => false,
            DevicePlace::Identity {
                vendor,
                product,
                serial,
            } => {
                identity.vendor == vendor
                    && identity.product == product
                    && serial.is_none_or(|serial| serial == identity.serial)
            }
            number => self.numbers.contains(&number),
        }
    }
}

impl fmt::Display for Present {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Identity {
            vendor,
            product,
            revision,
            serial,
        } = self.id.identity;
        write!(
            f,
            "{} ({vendor:08X}h:{product:08X}h, revision {revision:08X}h, serial {serial:08X}h",
            self.id.name
        )?;
        for number in self.numbers.iter().filter(|number| !number.is_nobodys()) {
            write!(f, ", {number}")?;
        }
        f.write_str(")")
    }
}

/// What is the matter with one place of the line.
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub enum LineVerdict {
    /// Nothing.
    Right,
    /// The expected device is not in the line.
    Missing,
    /// The device is expected nowhere, in a line that was declared complete.
    Extra,
    /// The device is expected nowhere, which is allowed.
    NotDeclared,
    /// The expected device stands at that position, and the one that is expected there stands here.
    Swapped {
        /// The other position.
        with: u16,
    },
    /// The expected device stands elsewhere.
    Moved {
        /// Where.
        to: u16,
    },
    /// Nothing is expected here; the device is expected elsewhere.
    Astray {
        /// Where.
        from: u16,
    },
    /// Another device stands here, and the expected one is not in the line.
    Different,
    /// Several devices have the alias or the identity.
    NotUnique {
        /// Where they stand.
        positions: Vec<u16>,
    },
    /// Another declaration means this device as well.
    DeclaredTwice,
}

impl fmt::Display for LineVerdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Right => f.write_str("right"),
            Self::Missing => f.write_str("missing"),
            Self::Extra => f.write_str("extra"),
            Self::NotDeclared => f.write_str("not declared"),
            Self::Swapped { with } => write!(f, "swapped with position {with}"),
            Self::Moved { to } => write!(f, "moved to position {to}"),
            Self::Astray { from } => write!(f, "expected at position {from}"),
            Self::Different => f.write_str("another device"),
            Self::NotUnique { positions } => {
                let positions: Vec<_> = positions.iter().map(u16::to_string).collect();
                write!(f, "not unique: positions {}", positions.join(", "))
            }
            Self::DeclaredTwice => f.write_str("declared twice"),
        }
    }
}

/// A place of the line, as expected and as found.
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub struct LineRow {
    /// The position; none where nothing was found for an alias or an identity.
    pub position: Option<u16>,
    /// What is expected, and how it is looked for.
    pub expected: Option<(DevicePlace, Expected)>,
    /// What is there.
    pub found: Option<Present>,
    /// What is the matter.
    pub verdict: LineVerdict,
}

impl LineRow {
    /// What stands here in place of another product of the same maker.
    fn other_product(&self) -> Option<(&Self, &Present)> {
        let ((_, expected), found) = (self.expected.as_ref()?, self.found.as_ref()?);
        let Identity {
            vendor, product, ..
        } = found.id.identity;
        let is_other = self.verdict == LineVerdict::Different
            && expected.vendor == Some(vendor)
            && expected.product.is_some_and(|expected| expected != product);
        is_other.then_some((self, found))
    }

    fn cells(&self) -> [String; 4] {
        let nothing = || String::from("-");
        let expected = self.expected.as_ref().map(|(place, device)| match place {
            DevicePlace::Position(_) => device.to_string(),
            place => format!("{place}: {device}"),
        });
        [
            self.position.map_or_else(nothing, |at| at.to_string()),
            expected.unwrap_or_else(nothing),
            self.found.as_ref().map_or_else(nothing, Present::to_string),
            self.verdict.to_string(),
        ]
    }
}

/// A line that is not the expected one: every place of it, those that are right as well. Shown as a table.
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct LineMismatch(pub Vec<LineRow>);

impl fmt::Display for LineMismatch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the line is not the expected one, and nothing was configured:")?;
        let head = ["position", "expected", "found", "verdict"].map(String::from);
        let rows: Vec<_> = std::iter::once(head)
            .chain(self.0.iter().map(LineRow::cells))
            .collect();
        let width = |column: usize| column_width(rows.iter().filter_map(|row| row.get(column)));
        let (first, second, third) = (width(0), width(1), width(2));
        for [position, expected, found, verdict] in &rows {
            write!(
                f,
                "\n  {position:first$}  {expected:second$}  {found:third$}  {verdict}"
            )?;
        }
        for (row, found) in self.0.iter().filter_map(LineRow::other_product) {
            let position = row.position.unwrap_or(found.id.position);
            let product = found.id.identity.product;
            write!(
                f,
                "\nAt position {position} is another product of the same maker. If it works as the expected one, accept it: set `product` \
                 of its `DriveDescription`, or the product code of its `Expected`, to 0x{product:08X}"
            )?;
        }
        Ok(())
    }
}

impl std::error::Error for LineMismatch {}

// Which device of the line is which expected one: pure, before anything is configured.

/// The place in `line` of each expected device, in their order.
pub(super) fn compare(
    expected: &[(DevicePlace, Expected)],
    line: &[Present],
    complete: bool,
) -> Result<Vec<usize>, LineMismatch> {
    let mut check = Check {
        expected,
        line,
        at: vec![None; expected.len()],
        verdicts: vec![None; expected.len()],
        taken: vec![None; line.len()],
    };
    check.look_where_they_are_expected();
    check.look_for_swapped();
    check.look_elsewhere();
    check.take_what_may_be_anything();
    let all_right = check
        .verdicts
        .iter()
        .all(|verdict| *verdict == Some(LineVerdict::Right));
    let all_expected = check.taken.iter().all(Option::is_some);
    if all_right && (all_expected || !complete) {
        return Ok(check.at.into_iter().flatten().collect());
    }
    Err(LineMismatch(check.rows(complete)))
}

/// Which of these devices each one of an optional group is; none unless all of it are there.
pub(super) fn locate(
    group: &[(DevicePlace, Expected)],
    there: &[Present],
) -> Result<Option<Vec<usize>>, LineMismatch> {
    let mut found = Vec::new();
    let mut rows = Vec::new();
    for (place, expected) in group {
        let meant = there
            .iter()
            .enumerate()
            .filter(|(_, device)| device.says(*place));
        let meant: Vec<_> = meant.collect();
        let (device, verdict) = match meant.as_slice() {
            [] => continue,
            &[(at, device)] if expected.matches(&device.id.identity) => {
                found.push(at);
                continue;
            }
            // Its EEPROM cannot be read yet.
            &[(_, device)] if device.id.identity == Identity::default() => continue,
            &[(_, device)] => (device, LineVerdict::Different),
            &[(_, device), ..] => {
                let positions = meant.iter().map(|(_, device)| device.id.position);
                let positions = positions.collect();
                (device, LineVerdict::NotUnique { positions })
            }
        };
        rows.push(LineRow {
            position: Some(device.id.position),
            expected: Some((*place, expected.clone())),
            found: Some(device.clone()),
            verdict,
        });
    }
    if rows.is_empty() {
        Ok((found.len() == group.len()).then_some(found))
    } else {
        Err(LineMismatch(rows))
    }
}

struct Check<'a> {
    expected: &'a [(DevicePlace, Expected)],
    line: &'a [Present],
    /// Of each expected device: where it stands, and what is the matter with it.
    at: Vec<Option<usize>>,
    verdicts: Vec<Option<LineVerdict>>,
    /// Of each device of the line: which expected one it is.
    taken: Vec<Option<usize>>,
}

impl Check<'_> {
    fn look_where_they_are_expected(&mut self) {
        for (number, (place, expected)) in self.expected.iter().enumerate() {
            let there: Vec<usize> = (0..self.line.len())
                .filter(|at| self.is_at(*place, *at))
                .collect();
            match (*place, there.as_slice()) {
                // It may stand elsewhere.
                (DevicePlace::Position(_), [at]) if !self.is(expected, *at) => {}
                (DevicePlace::Position(_), []) => {}
                (_, []) => self.judge(number, LineVerdict::Missing),
                (_, [at]) => {
                    self.at[number] = Some(*at);
                    let verdict = if self.taken[*at].is_some() {
                        LineVerdict::DeclaredTwice
                    } else if self.is(expected, *at) {
                        LineVerdict::Right
                    } else {
                        LineVerdict::Different
                    };
                    // What may be anything leaves the device to whoever is looking for it.
                    if expected.says_something() {
                        self.taken[*at].get_or_insert(number);
                    }
                    self.judge(number, verdict);
                }
                (_, several) => {
                    let positions = several.iter().map(|at| position(*at)).collect();
                    self.judge(number, LineVerdict::NotUnique { positions });
                }
            }
        }
    }

    /// Two that stand at each other's place.
    fn look_for_swapped(&mut self) {
        let open = self.open();
        for (place, &(one, here)) in open.iter().enumerate() {
            for &(other, there) in open.iter().skip(place + 1) {
                let free = self.verdicts[one].is_none() && self.verdicts[other].is_none();
                if free && self.could_be(one, there) && self.could_be(other, here) {
                    self.take(
                        one,
                        there,
                        LineVerdict::Swapped {
                            with: position(there),
                        },
                    );
                    self.take(
                        other,
                        here,
                        LineVerdict::Swapped {
                            with: position(here),
                        },
                    );
                }
            }
        }
    }

    /// The others, wherever such a device stands that is nobody else's.
    fn look_elsewhere(&mut self) {
        let open: Vec<_> = self
            .open()
            .into_iter()
            .filter(|(number, _)| self.verdicts[*number].is_none())
            .collect();
        for &(number, _) in &open {
            let elsewhere = (0..self.line.len()).find(|at| self.could_be(number, *at));
            if let Some(at) = elsewhere {
                self.take(number, at, LineVerdict::Moved { to: position(at) });
            }
        }
        for (number, here) in open {
            if self.verdicts[number].is_none() {
                let stranger = self.taken.get(here).is_some_and(Option::is_none);
                let verdict = if stranger {
                    LineVerdict::Different
                } else {
                    LineVerdict::Missing
                };
                self.judge(number, verdict);
            }
        }
    }

    /// Where somebody else's device stands, it is declared twice: one drive would get the set-points of two.
    fn take_what_may_be_anything(&mut self) {
        for (number, at) in self.at.iter().enumerate() {
            let Some(taken) = at.and_then(|at| self.taken.get_mut(at)) else {
                continue;
            };
            let by = *taken.get_or_insert(number);
            let both_right = [number, by].map(|one| self.verdicts[one] == Some(LineVerdict::Right));
            if by != number && both_right == [true, true] {
                self.verdicts[number] = Some(LineVerdict::DeclaredTwice);
            }
        }
    }

    fn rows(&self, complete: bool) -> Vec<LineRow> {
        let last = self.open_or_not().map(|(_, at)| at + 1).max().unwrap_or(0);
        let mut rows = Vec::new();
        for at in 0..last.max(self.line.len()) {
            let found = self.line.get(at).cloned();
            let row = |expected, verdict| LineRow {
                position: Some(position(at)),
                expected,
                found: found.clone(),
                verdict,
            };
            let expected: Vec<_> = (0..self.expected.len())
                .filter(|number| match self.expected[*number].0 {
                    DevicePlace::Position(position) => usize::from(position) == at,
                    _ => self.at[*number] == Some(at),
                })
                .collect();
            if expected.is_empty() {
                let verdict = match self.taken.get(at).copied().flatten() {
                    Some(number) => LineVerdict::Astray {
                        from: self.declared_position(number).unwrap_or_default(),
                    },
                    None if complete => LineVerdict::Extra,
                    None => LineVerdict::NotDeclared,
                };
                rows.push(row(None, verdict));
            }
            rows.extend(expected.into_iter().map(|number| {
                let verdict = self.verdicts[number].clone();
                let expected = Some(self.expected[number].clone());
                row(expected, verdict.unwrap_or(LineVerdict::Missing))
            }));
        }
        // Those that are looked for by something else than their position, and were not found.
        let nowhere = (0..self.expected.len()).filter(|number| {
            self.at[*number].is_none() && self.declared_position(*number).is_none()
        });
        rows.extend(nowhere.map(|number| {
            LineRow {
                position: None,
                expected: Some(self.expected[number].clone()),
                found: None,
                verdict: self.verdicts[number]
                    .clone()
                    .unwrap_or(LineVerdict::Missing),
            }
        }));
        rows
    }

    fn is_at(&self, place: DevicePlace, at: usize) -> bool {
        match place {
            DevicePlace::Position(position) => usize::from(position) == at,
            place => self.line.get(at).is_some_and(|present| present.says(place)),
        }
    }

    fn is(&self, expected: &Expected, at: usize) -> bool {
        let present = self.line.get(at);
        present.is_some_and(|present| expected.matches(&present.id.identity))
    }

    /// Whether an expected device can be this one, which is nobody else's.
    fn could_be(&self, number: usize, at: usize) -> bool {
        let (_, expected) = &self.expected[number];
        let free = self.taken.get(at).is_some_and(Option::is_none);
        free && expected.says_something() && self.is(expected, at)
    }

    /// Those that are expected at a position and were not found there, with their positions.
    fn open(&self) -> Vec<(usize, usize)> {
        self.open_or_not()
            .filter(|(number, _)| self.verdicts[*number].is_none())
            .collect()
    }

    fn open_or_not(&self) -> impl Iterator<Item = (usize, usize)> {
        let numbers = 0..self.expected.len();
        numbers.filter_map(|number| Some((number, self.declared_position(number)?.into())))
    }

    fn declared_position(&self, number: usize) -> Option<u16> {
        match self.expected.get(number)?.0 {
            DevicePlace::Position(position) => Some(position),
            _ => None,
        }
    }

    fn take(&mut self, number: usize, at: usize, verdict: LineVerdict) {
        self.at[number] = Some(at);
        self.taken[at] = Some(number);
        self.judge(number, verdict);
    }

    fn judge(&mut self, number: usize, verdict: LineVerdict) {
        self.verdicts[number] = Some(verdict);
    }
}

/// A line has at most 65535 devices: their number comes as a working counter.
fn position(at: usize) -> u16 {
    u16::try_from(at).unwrap_or(u16::MAX)
}
