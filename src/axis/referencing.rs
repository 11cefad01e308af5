//! Whether the positions of an axis mean anything: since a homing, by an absolute encoder, or not at all.

/// How an axis comes to know where it is. Without that, absolute moves are refused as
/// [`Failure::NotReferenced`](super::Failure::NotReferenced); relative moves, homing and jogging need no reference.
///
/// ```
/// use servocrab::{axis::Referencing, bus::DriveConfig, drives};
/// let drive = DriveConfig::new(drives::akd2g())
///     .axis("lift")
///     .referencing("lift", Referencing::AbsoluteEncoder)
///     .axis("belt"); // this one must be homed before its first absolute move
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Referencing {
    /// By a homing that was attained since the drive was last lost. The next homing takes the reference away until it is attained.
    /// So does every loss of the drive: nothing shows whether it has kept its power and its position. A fault alone does not; a
    /// program that knows better homes again.
    #[default]
    ByHoming,
    /// The drive always knows its position, in the coordinates that the program means.
    AbsoluteEncoder,
    /// The axis is moved to absolute positions without knowing what they mean: 6064h counts from wherever the drive was
    /// switched on. For test benches and for axes that nothing stands in the way of.
    UnreferencedMovesAllowed,
}
