//! The table of stops in `docs/motion.md`: written by a test of the core on the simulated drives and their plants.

use std::process::Command;

/// Writes the times of stops on the simulated drives into docs/motion.md.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Changes nothing, and fails where the page differs.
    #[arg(long)]
    check: bool,
}

const BEGIN: &str = "<!-- motion-table: `cargo xtask motion-table` writes what follows -->\n";
const END: &str = "<!-- motion-table ends -->\n";

pub(crate) fn run(args: &Args) -> crate::Result<()> {
    let table = table()?;
    let path = crate::root().join("docs/motion.md");
    let page = std::fs::read_to_string(&path)?;
    let new = with(&page, &table).ok_or("docs/motion.md has no place for the table")?;
    if new == page {
        println!("docs/motion.md is up to date");
        return Ok(());
    }
    if args.check {
        return Err(
            "the table in docs/motion.md is not what the drives show: cargo xtask motion-table"
                .into(),
        );
    }
    std::fs::write(&path, new)?;
    println!("docs/motion.md is written");
    Ok(())
}

/// The table, from a run of the test that makes it; the test fails where a stop resolves at the wrong time.
fn table() -> crate::Result<String> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let output = Command::new(cargo)
        .current_dir(crate::root())
        .args([
            "test",
            "--quiet",
            // With the features that `cargo test --workspace` has built it with.
            "--workspace",
            "--test",
            "motion",
            "--",
            "motion_table::",
            "--include-ignored",
            "--nocapture",
        ])
        .output()?;
    let text = String::from_utf8_lossy(&output.stdout);
    if !output.status.success() {
        return Err(format!("{text}{}", String::from_utf8_lossy(&output.stderr)).into());
    }
    let table = text
        .split_once("TABLE\n")
        .and_then(|(_, rest)| rest.split_once("END"))
        .map(|(table, _)| table.to_owned());
    table.ok_or_else(|| "the test printed no table".into())
}

/// The page with this table between its marks.
fn with(page: &str, table: &str) -> Option<String> {
    let (before, rest) = page.split_once(BEGIN)?;
    let (_, after) = rest.split_once(END)?;
    Some(format!("{before}{BEGIN}\n{table}\n{END}{after}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_between_the_marks_is_replaced() {
        let page = format!("a\n{BEGIN}old\n{END}b\n");
        let new = with(&page, "| t |\n").expect("a place");
        assert_eq!(new, format!("a\n{BEGIN}\n| t |\n\n{END}b\n"));
        assert_eq!(with(&new, "| t |\n").as_deref(), Some(new.as_str()));
        assert_eq!(with("no marks", ""), None);
    }
}
