//! Writes the inputs to begin with into `corpus/TARGET/`, one file each.

use servocrab_fuzz::{seeds, targets};

fn main() -> std::io::Result<()> {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus");
    for (name, _) in targets::ALL {
        let folder = root.join(name);
        std::fs::create_dir_all(&folder)?;
        for (number, seed) in seeds::of(name).into_iter().enumerate() {
            std::fs::write(folder.join(format!("seed-{number:02}")), seed)?;
        }
    }
    Ok(())
}
