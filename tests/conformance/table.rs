//! What a row is. A row cannot be written without its tests: the cells name functions.

/// One source document.
#[derive(Debug)]
pub(crate) struct Document {
    /// Its title, and what it is about.
    pub(crate) title: &'static str,
    pub(crate) about: &'static str,
    pub(crate) rows: &'static [Row],
    /// What it says that is no behaviour of drive or library, and why there is no row for it.
    pub(crate) without_row: &'static [(&'static str, &'static str)],
}

/// One behaviour.
#[derive(Debug)]
pub(crate) struct Row {
    pub(crate) id: &'static str,
    /// Where the document says it: section, table or object.
    pub(crate) section: &'static str,
    /// What it says, in our words.
    pub(crate) says: &'static str,
    /// The simulated drive, fed with objects and controlwords.
    pub(crate) drive: Cell,
    /// The library, on that simulated drive or alone.
    pub(crate) library: Cell,
}

/// One column of a row.
#[derive(Debug)]
pub(crate) enum Cell {
    /// This test, red with this mutation.
    By {
        /// The test's path, the crate included.
        test: &'static str,
        /// Its id in `tests/mutants.toml`.
        mutation: &'static str,
    },
    /// It has no part in it, for this reason.
    NoPart(&'static str),
}

impl Cell {
    /// `_function` is there so that only a test that exists can be named; that it is run, `cargo xtask mutants` sees.
    pub(crate) const fn by(test: &'static str, mutation: &'static str, _function: fn()) -> Self {
        Self::By { test, mutation }
    }

    /// The test as the test binary names it, and the mutation.
    pub(crate) fn test(&self) -> Option<(&'static str, &'static str)> {
        match self {
            Self::By { test, mutation } => Some((
                test.split_once("::").map_or(*test, |(_, name)| name),
                mutation,
            )),
            Self::NoPart(_) => None,
        }
    }
}

/// The cell of a test function and its mutation.
macro_rules! by {
    ($test:path, $mutation:literal) => {
        crate::table::Cell::by(
            concat!(module_path!(), "::", stringify!($test)),
            $mutation,
            $test,
        )
    };
}
