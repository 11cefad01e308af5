//! Which device of the line is which expected one: pure, before anything is configured.

use super::expected::{DevicePlace, Expected, LineMismatch, LineRow, Present, Verdict};

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
        .all(|verdict| *verdict == Some(Verdict::Right));
    let all_expected = check.taken.iter().all(Option::is_some);
    if all_right && (all_expected || !complete) {
        return Ok(check.at.into_iter().flatten().collect());
    }
    Err(LineMismatch(check.rows(complete)))
}

struct Check<'a> {
    expected: &'a [(DevicePlace, Expected)],
    line: &'a [Present],
    /// Of each expected device: where it stands, and what is the matter with it.
    at: Vec<Option<usize>>,
    verdicts: Vec<Option<Verdict>>,
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
                (_, []) => self.judge(number, Verdict::Missing),
                (_, [at]) => {
                    self.at[number] = Some(*at);
                    let verdict = if self.taken[*at].is_some() {
                        Verdict::DeclaredTwice
                    } else if self.is(expected, *at) {
                        Verdict::Right
                    } else {
                        Verdict::Different
                    };
                    // What may be anything leaves the device to whoever is looking for it.
                    if expected.says_something() {
                        self.taken[*at].get_or_insert(number);
                    }
                    self.judge(number, verdict);
                }
                (_, several) => {
                    let positions = several.iter().map(|at| position(*at)).collect();
                    self.judge(number, Verdict::NotUnique { positions });
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
                        Verdict::Swapped {
                            with: position(there),
                        },
                    );
                    self.take(
                        other,
                        here,
                        Verdict::Swapped {
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
                self.take(number, at, Verdict::Moved { to: position(at) });
            }
        }
        for (number, here) in open {
            if self.verdicts[number].is_none() {
                let stranger = self.taken.get(here).is_some_and(Option::is_none);
                let verdict = if stranger {
                    Verdict::Different
                } else {
                    Verdict::Missing
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
            let both_right = [number, by].map(|one| self.verdicts[one] == Some(Verdict::Right));
            if by != number && both_right == [true, true] {
                self.verdicts[number] = Some(Verdict::DeclaredTwice);
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
                    Some(number) => Verdict::Astray {
                        from: self.declared_position(number).unwrap_or_default(),
                    },
                    None if complete => Verdict::Extra,
                    None => Verdict::NotDeclared,
                };
                rows.push(row(None, verdict));
            }
            rows.extend(expected.into_iter().map(|number| {
                let verdict = self.verdicts[number].clone();
                let expected = Some(self.expected[number].clone());
                row(expected, verdict.unwrap_or(Verdict::Missing))
            }));
        }
        // Those that are looked for by something else than their position, and were not found.
        let nowhere = (0..self.expected.len()).filter(|number| {
            self.at[*number].is_none() && self.declared_position(*number).is_none()
        });
        rows.extend(nowhere.map(|number| LineRow {
            position: None,
            expected: Some(self.expected[number].clone()),
            found: None,
            verdict: self.verdicts[number].clone().unwrap_or(Verdict::Missing),
        }));
        rows
    }

    fn is_at(&self, place: DevicePlace, at: usize) -> bool {
        let Some(present) = self.line.get(at) else {
            return false;
        };
        let identity = &present.id.identity;
        match place {
            DevicePlace::Position(position) => usize::from(position) == at,
            DevicePlace::Alias(alias) => present.alias == Some(alias),
            DevicePlace::Identity {
                vendor,
                product,
                serial,
            } => {
                identity.vendor == vendor
                    && identity.product == product
                    && serial.is_none_or(|serial| serial == identity.serial)
            }
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

    fn take(&mut self, number: usize, at: usize, verdict: Verdict) {
        self.at[number] = Some(at);
        self.taken[at] = Some(number);
        self.judge(number, verdict);
    }

    fn judge(&mut self, number: usize, verdict: Verdict) {
        self.verdicts[number] = Some(verdict);
    }
}

/// A line has at most 65535 devices: their number comes as a working counter.
fn position(at: usize) -> u16 {
    u16::try_from(at).unwrap_or(u16::MAX)
}
