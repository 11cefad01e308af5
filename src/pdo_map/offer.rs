//! A mapping made of what a drive offers: PDOs with a fixed content are chosen, free ones are filled.

use alloc::vec::Vec;

use super::mapping::MappingError;
use super::mapping::{Direction, Mapping, MappingLimits, entry_of};
use super::mapping::{Entry, MappedPdo};
use crate::coe::AnyObject;

/// Fixed PDOs of one direction among which is chosen, beside the mandatory ones: those that hold most of what is wanted.
const MOST_CANDIDATES: usize = 32;
/// Combinations of them that are looked at, those with the PDOs that hold most first.
const MOST_COMBINATIONS: usize = 1 << 13;

/// A PDO that a drive offers with a content of its own: it can be assigned and not changed.
///
/// ```
/// use servocrab::pdo_map::{Entry, FixedPdo};
/// // The target position with the controlword, as many drives offer them.
/// let pdo = FixedPdo::new(0x1701, [Entry::new(0x6040, 0, 16), Entry::new(0x607A, 0, 32)]);
/// assert_eq!(pdo.pdo.bits(), 48);
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FixedPdo {
    /// The PDO.
    pub pdo: MappedPdo,
    /// It must be assigned whatever else is.
    pub mandatory: bool,
    /// PDOs that cannot be assigned beside it.
    pub excludes: Vec<u16>,
}

impl FixedPdo {
    /// A PDO that may be assigned beside any other.
    #[must_use]
    pub fn new(index: u16, entries: impl IntoIterator<Item = Entry>) -> Self {
        Self {
            pdo: MappedPdo {
                index,
                entries: entries.into_iter().collect(),
            },
            mandatory: false,
            excludes: Vec::new(),
        }
    }

    fn holds(&self, entry: Entry) -> bool {
        self.pdo.entries.contains(&entry)
    }

    /// Whether both can be assigned at once: neither excludes the other, and nothing would be written in two places.
    fn stands_beside(&self, other: &Self, direction: Direction) -> bool {
        let excluded =
            self.excludes.contains(&other.pdo.index) || other.excludes.contains(&self.pdo.index);
        let shared = |entry: &Entry| {
            !entry.is_padding()
                && other
                    .pdo
                    .entries
                    .iter()
                    .any(|held| held.address() == entry.address())
        };
        !excluded && (direction == Direction::Inputs || !self.pdo.entries.iter().any(shared))
    }
}

/// An object that is wanted in the process data.
///
/// ```
/// use servocrab::{coe::obj, pdo_map::{Demand, Direction, MappingLimits, choose}};
/// let wanted = Demand {
///     direction: Direction::Inputs,
///     object: obj::STATUSWORD.into(),
///     required: true,
///     free: &[0x1A00],
/// };
/// assert_eq!(choose(&[wanted], &[], &MappingLimits::default())?.inputs()[0].index, 0x1A00);
/// # Ok::<(), servocrab::pdo_map::MappingError>(())
/// ```
#[derive(Debug, Clone, Copy)]
pub struct Demand<'a> {
    /// Which way.
    pub direction: Direction,
    /// The object, of its own axis.
    pub object: AnyObject,
    /// Without it there is no mapping; others are left out where no PDO that can be assigned holds them.
    pub required: bool,
    /// The PDOs with a free content that it can be mapped into, in this order.
    pub free: &'a [u16],
}

/// The mapping with which a drive exchanges what is wanted.
///
/// Without `fixed` PDOs of a direction, the objects fill the free ones in the order of the demands. The next PDO follows when one
/// holds as many as its [`MappingLimits`] allow. Where not all fit, those that are required do first, then the first of the others. With them, the combination is taken that leaves out the fewest wanted objects. Of
/// such combinations the one with the fewest bytes is taken, then the one with the fewest PDOs. The search is bounded, and begins
/// with the PDOs that hold most. No output is mapped twice. PDOs are assigned by rising index.
///
/// ```
/// use servocrab::coe::obj;
/// use servocrab::pdo_map::{Demand, Direction, Entry, FixedPdo, MappingLimits, choose};
///
/// let wanted = [obj::CONTROLWORD.into(), obj::TARGET_POSITION.into()].map(|object| Demand {
///     direction: Direction::Outputs,
///     object,
///     required: true,
///     free: &[],
/// });
/// let (controlword, target) = (Entry::new(0x6040, 0, 16), Entry::new(0x607A, 0, 32));
/// let offered = [FixedPdo::new(0x1600, [controlword]), FixedPdo::new(0x1601, [controlword, target])];
/// let mapping = choose(&wanted, &offered, &MappingLimits::default())?;
/// assert_eq!(mapping.outputs().len(), 1);
/// assert_eq!(mapping.outputs()[0].index, 0x1601);
/// # Ok::<(), servocrab::pdo_map::MappingError>(())
/// ```
///
/// # Errors
/// [`MappingError`]: an object that cannot be mapped that way, is wanted twice or, being required, is in no PDO that can be
/// assigned; a free PDO of the other direction; or more than the drive's `limits`.
pub fn choose(
    demands: &[Demand<'_>],
    fixed: &[FixedPdo],
    limits: &MappingLimits,
) -> Result<Mapping, MappingError> {
    let mut chosen_fixed = Vec::new();
    let mut sides = [Vec::new(), Vec::new()];
    for (direction, side) in [Direction::Outputs, Direction::Inputs]
        .into_iter()
        .zip(&mut sides)
    {
        let wanted = wanted(direction, demands)?;
        let mut offered: Vec<_> = fixed
            .iter()
            .filter(|offer| direction.pdo_range().contains(&offer.pdo.index))
            .collect();
        // Those that hold most come first, so that a bounded search meets the likely ones.
        offered.sort_by_key(|offer| {
            let held = wanted.iter().filter(|want| offer.holds(want.entry)).count();
            (core::cmp::Reverse(held), offer.pdo.index)
        });
        let mandatory: Vec<_> = offered
            .iter()
            .filter(|offer| offer.mandatory)
            .copied()
            .collect();
        // The others, as far as they hold something wanted; a file or a drive can offer hundreds.
        offered
            .retain(|offer| !offer.mandatory && wanted.iter().any(|want| offer.holds(want.entry)));
        let rest = offered.split_off(offered.len().min(MOST_CANDIDATES));
        // An object that none of them holds keeps its first PDO.
        for want in &wanted {
            if !offered.iter().any(|offer| offer.holds(want.entry)) {
                offered.extend(rest.iter().find(|offer| offer.holds(want.entry)));
            }
        }
        let mut search = Search {
            direction,
            wanted: &wanted,
            offered: &offered,
            limits,
            left: MOST_COMBINATIONS,
            best: None,
        };
        search.look(&mandatory, 0);
        let Some(best) = search.best else { continue };
        if let Some(missing) = best.left_out.iter().find(|want| want.required) {
            return Err(MappingError::NotOffered {
                object: missing.entry.address(),
                name: missing.name,
                direction,
            });
        }
        chosen_fixed.extend(best.fixed);
        *side = best.pdos;
    }
    let [outputs, inputs] = sides;
    Mapping::from_pdos(outputs, inputs)
        .with_fixed(&chosen_fixed)
        .within(limits)
}

/// A demand of one direction, checked.
#[derive(Clone, Copy)]
struct Want<'a> {
    entry: Entry,
    name: &'static str,
    required: bool,
    free: &'a [u16],
}

fn wanted<'a>(direction: Direction, demands: &[Demand<'a>]) -> Result<Vec<Want<'a>>, MappingError> {
    let mut all: Vec<Want<'a>> = Vec::new();
    for demand in demands
        .iter()
        .filter(|demand| demand.direction == direction)
    {
        let entry = entry_of(direction, demand.object)?;
        if all
            .iter()
            .any(|want| want.entry.address() == entry.address())
        {
            return Err(MappingError::ObjectTwice {
                object: entry.address(),
                direction,
            });
        }
        let other = |pdo: &&u16| !direction.pdo_range().contains(pdo);
        if let Some(pdo) = demand.free.iter().find(other) {
            return Err(MappingError::WrongPdo {
                pdo: *pdo,
                direction,
            });
        }
        all.push(Want {
            entry,
            name: demand.object.name,
            required: demand.required,
            free: demand.free,
        });
    }
    Ok(all)
}

/// A look at all combinations of fixed PDOs, up to a bound.
struct Search<'a> {
    direction: Direction,
    wanted: &'a [Want<'a>],
    offered: &'a [&'a FixedPdo],
    limits: &'a MappingLimits,
    left: usize,
    best: Option<Choice<'a>>,
}

/// One way to serve what is wanted.
struct Choice<'a> {
    pdos: Vec<MappedPdo>,
    fixed: Vec<u16>,
    left_out: Vec<Want<'a>>,
    cost: Cost,
}

/// Compared from the first to the last; the lowest is best.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct Cost {
    required_left_out: usize,
    over_limits: bool,
    left_out: usize,
    bits: usize,
    pdos: usize,
}

impl<'a> Search<'a> {
    /// Judges `chosen`, and then everything that has further PDOs from `next` on.
    fn look(&mut self, chosen: &[&'a FixedPdo], next: usize) {
        if self.left == 0 {
            return;
        }
        self.left -= 1;
        let choice = self.choice(chosen);
        let is_better = self
            .best
            .as_ref()
            .is_none_or(|best| choice.cost < best.cost);
        if is_better {
            self.best = Some(choice);
        }
        if chosen.len() >= self.limits.pdos(self.direction) {
            return;
        }
        let offered = self.offered;
        for (place, offer) in offered.iter().enumerate().skip(next) {
            let brings = self.wanted.iter().any(|want| {
                offer.holds(want.entry) && !chosen.iter().any(|other| other.holds(want.entry))
            });
            let fits = chosen.iter().all(|other| {
                other.pdo.index != offer.pdo.index && other.stands_beside(offer, self.direction)
            });
            if brings && fits {
                let mut more = chosen.to_vec();
                more.push(offer);
                self.look(&more, place + 1);
            }
        }
    }

    /// What is served with these fixed PDOs: what they do not hold goes into the free ones.
    fn choice(&self, chosen: &[&'a FixedPdo]) -> Choice<'a> {
        let (needed, further): (Vec<_>, Vec<_>) =
            self.wanted.iter().partition(|want| want.required);
        let (_, left_out) = self.fill(chosen, needed.into_iter().chain(further));
        let served = |want: &&Want<'_>| {
            let missing = |left: &Want<'_>| left.entry.address() == want.entry.address();
            !left_out.iter().any(missing)
        };
        let (mut pdos, _) = self.fill(chosen, self.wanted.iter().filter(served));
        pdos.sort_by_key(|pdo| pdo.index);
        let bits = pdos.iter().map(MappedPdo::bits).sum();
        let most_bytes = self.limits.bytes(self.direction);
        let cost = Cost {
            required_left_out: left_out.iter().filter(|want| want.required).count(),
            over_limits: pdos.len() > self.limits.pdos(self.direction)
                || bits > most_bytes.saturating_mul(8),
            left_out: left_out.len(),
            bits,
            pdos: pdos.len(),
        };
        Choice {
            pdos,
            fixed: chosen.iter().map(|offer| offer.pdo.index).collect(),
            left_out,
            cost,
        }
    }

    /// Puts what is wanted, as long as there is room, into free PDOs beside these fixed ones; and what has found none.
    fn fill<'w>(
        &self,
        chosen: &[&FixedPdo],
        wanted: impl Iterator<Item = &'w Want<'a>>,
    ) -> (Vec<MappedPdo>, Vec<Want<'a>>)
    where
        'a: 'w,
    {
        let mut pdos: Vec<MappedPdo> = chosen.iter().map(|offer| offer.pdo.clone()).collect();
        let mut left_out = Vec::new();
        for want in wanted {
            let held = |offer: &&FixedPdo| {
                let same = |entry: &Entry| entry.address() == want.entry.address();
                // In another width it is there too: it cannot be mapped once more.
                offer.pdo.entries.iter().any(same)
            };
            if chosen.iter().any(|offer| offer.holds(want.entry)) {
                continue;
            }
            let goes_into = (!chosen.iter().any(held))
                .then(|| self.room(&pdos, want))
                .flatten();
            match goes_into {
                None => left_out.push(*want),
                Some(index) => match pdos.iter_mut().find(|pdo| pdo.index == index) {
                    Some(pdo) => pdo.entries.push(want.entry),
                    None => pdos.push(MappedPdo {
                        index,
                        entries: alloc::vec![want.entry],
                    }),
                },
            }
        }
        (pdos, left_out)
    }

    /// The first of its free PDOs with room for one more object. What is required goes into the last one all the same, so that
    /// the limit it breaks is named.
    fn room(&self, pdos: &[MappedPdo], want: &Want<'_>) -> Option<u16> {
        let has_room = |index: &&u16| {
            let most = self.limits.entries(**index);
            match pdos.iter().find(|pdo| pdo.index == **index) {
                Some(pdo) => pdo.entries.len() < most,
                None => most > 0 && pdos.len() < self.limits.pdos(self.direction),
            }
        };
        let with_room = want.free.iter().find(has_room);
        let last = want.free.last().filter(|_| want.required);
        with_room.or(last).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coe::obj;
    use alloc::vec;

    const CONTROLWORD: Entry = Entry::new(0x6040, 0, 16);
    const MODE: Entry = Entry::new(0x6060, 0, 8);
    const TARGET: Entry = Entry::new(0x607A, 0, 32);
    const VELOCITY: Entry = Entry::new(0x6081, 0, 32);

    fn output(object: impl Into<AnyObject>, required: bool, free: &[u16]) -> Demand<'_> {
        Demand {
            direction: Direction::Outputs,
            object: object.into(),
            required,
            free,
        }
    }

    fn position(free: &[u16]) -> Vec<Demand<'_>> {
        vec![
            output(obj::CONTROLWORD, true, free),
            output(obj::MODE_OF_OPERATION, false, free),
            output(obj::TARGET_POSITION, true, free),
            output(obj::PROFILE_VELOCITY, false, free),
        ]
    }

    fn indices(mapping: &Mapping) -> Vec<u16> {
        mapping.outputs().iter().map(|pdo| pdo.index).collect()
    }

    /// CiA 301: in a PDO a data type (0001h and on, subindex 0) is a gap. There can be many of one.
    #[test]
    fn gaps_of_fixed_pdos_that_are_written_as_data_types_are_no_object_that_is_mapped_twice() {
        let gap = Entry::new(0x0005, 0, 8);
        let both = [FixedPdo::new(0x1701, [CONTROLWORD, MODE, gap, TARGET, gap])];
        let mapping = choose(&position(&[]), &both, &MappingLimits::default()).unwrap();
        assert_eq!(indices(&mapping), [0x1701]);
        // The drive is to hold what it offers.
        assert_eq!(mapping.outputs()[0].entries[2].raw(), 0x0005_0008);
        let each = [
            FixedPdo::new(0x1701, [CONTROLWORD, gap]),
            FixedPdo::new(0x1702, [TARGET, gap]),
        ];
        let mapping = choose(&position(&[]), &each, &MappingLimits::default());
        assert_eq!(
            mapping.map(|mapping| indices(&mapping)),
            Ok(vec![0x1701, 0x1702])
        );
    }

    /// The outputs of some devices are 0005h:01, 0005h:02 and on.
    #[test]
    fn an_object_among_the_data_types_that_is_mapped_twice_is_found() {
        let byte = Entry::new(0x0005, 1, 8);
        let offered = [FixedPdo::new(0x1701, [CONTROLWORD, byte, TARGET, byte])];
        assert_eq!(
            choose(&position(&[]), &offered, &MappingLimits::default()),
            Err(MappingError::ObjectTwice {
                object: byte.address(),
                direction: Direction::Outputs
            })
        );
    }

    #[test]
    fn the_offered_pdo_with_most_of_what_is_wanted_is_chosen_and_not_filled() {
        let offered = [
            FixedPdo::new(0x1700, [CONTROLWORD]),
            FixedPdo::new(0x1701, [CONTROLWORD, TARGET]),
            FixedPdo::new(0x1702, [CONTROLWORD, Entry::padding(8), MODE, TARGET]),
        ];
        let mapping = choose(&position(&[]), &offered, &MappingLimits::default()).unwrap();
        assert_eq!(indices(&mapping), [0x1702]);
        assert!(
            !mapping
                .plan()
                .steps()
                .iter()
                .any(|step| step.object.index == 0x1702)
        );
        assert_eq!(mapping.layout().output_bytes(), 8);
        let target = mapping
            .layout()
            .find(Direction::Outputs, 0x607A, 0)
            .unwrap();
        assert_eq!(target.byte, 4, "behind the padding");
    }

    #[test]
    fn no_object_is_written_in_two_places() {
        // As a first-generation AKD has them: the controlword is in each.
        let offered = [
            FixedPdo::new(0x1601, [CONTROLWORD, MODE]),
            FixedPdo::new(0x1602, [CONTROLWORD, TARGET]),
        ];
        let mapping = choose(&position(&[]), &offered, &MappingLimits::default()).unwrap();
        assert_eq!(indices(&mapping), [0x1602]);
    }

    #[test]
    fn what_fixed_pdos_lack_goes_into_the_free_one() {
        let offered = [FixedPdo::new(0x1601, [CONTROLWORD, TARGET])];
        let mut semi = position(&[0x1600]);
        // On this drive the target cannot be mapped freely.
        semi[2].free = &[];
        let mapping = choose(&semi, &offered, &MappingLimits::default()).unwrap();
        assert_eq!(indices(&mapping), [0x1600, 0x1601]);
        assert_eq!(mapping.outputs()[0].entries, [MODE, VELOCITY]);
        assert!(mapping.is_fixed(0x1601) && !mapping.is_fixed(0x1600));
    }

    #[test]
    fn a_full_pdo_is_followed_by_the_next_of_the_axis() {
        let limits = MappingLimits {
            entries_per_pdo: 3,
            output_pdos: 2,
            ..MappingLimits::default()
        };
        let mapping = choose(&position(&[0x1600, 0x1601]), &[], &limits).unwrap();
        assert_eq!(indices(&mapping), [0x1600, 0x1601]);
        assert_eq!(mapping.outputs()[1].entries, [VELOCITY]);
        let mut all = position(&[0x1600]);
        all.iter_mut().for_each(|demand| demand.required = true);
        assert_eq!(
            choose(&all, &[], &limits),
            Err(MappingError::TooManyEntries {
                pdo: 0x1600,
                entries: 4,
                limit: 3
            })
        );
        let mut all = position(&[0x1600, 0x1601]);
        all.iter_mut().for_each(|demand| demand.required = true);
        let one_pdo = MappingLimits {
            output_pdos: 1,
            ..limits
        };
        assert_eq!(
            choose(&all, &[], &one_pdo),
            Err(MappingError::TooManyPdos {
                direction: Direction::Outputs,
                pdos: 2,
                limit: 1
            })
        );
    }

    #[test]
    fn where_not_all_fit_what_is_needed_does_first() {
        for (most, expected) in [
            (3, &[CONTROLWORD, MODE, TARGET][..]),
            (2, &[CONTROLWORD, TARGET]),
        ] {
            let limits = MappingLimits {
                entries_per_pdo: most,
                output_pdos: 1,
                ..MappingLimits::default()
            };
            let mapping = choose(&position(&[0x1600, 0x1601]), &[], &limits).unwrap();
            assert_eq!(indices(&mapping), [0x1600]);
            assert_eq!(mapping.outputs()[0].entries, expected);
        }
        // A PDO that the drive does not have.
        let limits = MappingLimits {
            other_pdos: vec![(0x1600, 0)],
            ..MappingLimits::default()
        };
        let mapping = choose(&position(&[0x1600, 0x1601]), &[], &limits).unwrap();
        assert_eq!(indices(&mapping), [0x1601]);
    }

    #[test]
    fn mandatory_and_excluded_pdos_are_heeded() {
        let mut status = FixedPdo::new(0x1603, [Entry::new(0x2001, 0, 8)]);
        status.mandatory = true;
        status.excludes = vec![0x1600];
        let offered = [
            FixedPdo::new(0x1600, [CONTROLWORD, MODE, TARGET, VELOCITY]),
            FixedPdo::new(0x1601, [CONTROLWORD, TARGET]),
            status,
        ];
        let mapping = choose(&position(&[]), &offered, &MappingLimits::default()).unwrap();
        assert_eq!(indices(&mapping), [0x1601, 0x1603]);
    }

    #[test]
    fn a_required_object_that_nothing_offers_is_named() {
        let offered = [FixedPdo::new(0x1600, [CONTROLWORD, MODE])];
        let error = choose(&position(&[]), &offered, &MappingLimits::default()).unwrap_err();
        assert_eq!(
            error,
            MappingError::NotOffered {
                object: TARGET.address(),
                name: obj::TARGET_POSITION.name(),
                direction: Direction::Outputs
            }
        );
    }

    #[test]
    fn hundreds_of_offered_pdos_are_chosen_among_in_bounded_time() {
        let all = [CONTROLWORD, MODE, TARGET, VELOCITY];
        let offered: Vec<_> = (0x1600..0x1800)
            .map(|index| {
                let place = usize::from(index) % all.len();
                let further = (1..60).map(|subindex| Entry::new(0x2000 + index, subindex, 8));
                FixedPdo::new(index, core::iter::once(all[place]).chain(further))
            })
            .collect();
        let mapping = choose(&position(&[]), &offered, &MappingLimits::default()).unwrap();
        assert_eq!(mapping.outputs().len(), 4);
        // The target in the last alone, behind many that hold two of the others.
        let mut offered: Vec<_> = (0x1600..0x1700)
            .map(|index| FixedPdo::new(index, [CONTROLWORD, MODE]))
            .collect();
        offered.push(FixedPdo::new(0x1700, [TARGET]));
        let mapping = choose(&position(&[]), &offered, &MappingLimits::default()).unwrap();
        assert_eq!(indices(&mapping), [0x1600, 0x1700]);
    }

    proptest::proptest! {
        #[test]
        fn whatever_is_offered_a_chosen_mapping_is_within_its_rules(
            contents in proptest::collection::vec(proptest::collection::vec(0usize..4, 0..4), 0..12),
            most in 1usize..4,
        ) {
            let all = [CONTROLWORD, MODE, TARGET, VELOCITY];
            let offered: Vec<_> = (0x1600..).zip(&contents).map(|(index, content)| {
                let mut content = content.clone();
                content.sort_unstable();
                content.dedup();
                FixedPdo::new(index, content.into_iter().map(|place| all[place]))
            }).collect();
            let limits = MappingLimits { output_pdos: most, ..MappingLimits::default() };
            match choose(&position(&[]), &offered, &limits) {
                Ok(mapping) => {
                    proptest::prop_assert!(mapping.outputs().len() <= most);
                    for pdo in mapping.outputs() {
                        proptest::prop_assert!(offered.iter().any(|offer| offer.pdo == *pdo));
                    }
                    for entry in all {
                        let times = mapping.outputs().iter().flat_map(|pdo| &pdo.entries).filter(|held| **held == entry).count();
                        proptest::prop_assert!(times <= 1);
                        let needed = entry == CONTROLWORD || entry == TARGET;
                        proptest::prop_assert!(!needed || times == 1);
                    }
                }
                // Then no single PDO holds both.
                Err(_) => for offer in &offered {
                    proptest::prop_assert!(!(offer.holds(CONTROLWORD) && offer.holds(TARGET)));
                }
            }
        }
    }
}
