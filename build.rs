//! Generates the wire types and their proto3 JSON from `proto/`, without `protoc`. Does nothing for the core alone.

fn main() -> Result<(), Box<dyn std::error::Error>> {
    #[cfg(feature = "server")]
    wire::generate()?;
    Ok(())
}

#[cfg(feature = "server")]
mod wire {
    use std::path::PathBuf;
    use std::{env, fs};

    /// The package of the interface.
    const PACKAGE: &str = ".ubbmap.v1";

    /// How the generator of the JSON code reads numbers: through a buffer, and with an error that does not say what
    /// was expected. Ours reads them directly.
    const THEIR_NUMBER: &str = "::pbjson::private::NumberDeserialize";

    pub fn generate() -> Result<(), Box<dyn std::error::Error>> {
        println!("cargo:rerun-if-changed=proto");
        let mut files: Vec<PathBuf> =
            fs::read_dir("proto/ubbmap/v1")?.map(|entry| entry.map(|entry| entry.path())).collect::<Result<_, _>>()?;
        files.retain(|path| path.extension().is_some_and(|extension| extension == "proto"));
        files.sort();
        let descriptors = protox::compile(&files, ["proto"])?;

        prost_build::Config::new().btree_map(["."]).compile_fds(descriptors.clone())?;

        let mut json = pbjson_build::Builder::new();
        for file in descriptors.file {
            json.register_file_descriptor(file);
        }
        json.preserve_proto_field_names().emit_fields().btree_map(["."]).build(&[PACKAGE])?;

        let generated = PathBuf::from(env::var("OUT_DIR")?).join("ubbmap.v1.serde.rs");
        let code = fs::read_to_string(&generated)?;
        if !code.contains(THEIR_NUMBER) {
            return Err(format!("{THEIR_NUMBER} is not in the generated JSON code").into());
        }
        fs::write(&generated, code.replace(THEIR_NUMBER, "crate::wire::JsonNumber"))?;
        Ok(())
    }
}
