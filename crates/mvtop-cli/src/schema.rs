//! JSON Schemas of documents.

use mvtop_core::schema::{self, Document};

use crate::args::{Schema, SchemaOf};
use crate::failure::Result;
use crate::write;

pub fn run(args: &Schema) -> Result<()> {
    let document = match args.document {
        SchemaOf::Prediction => Document::Prediction,
        SchemaOf::Request => Document::Request,
        SchemaOf::Bundle => Document::Bundle,
        SchemaOf::Rig => Document::Rig,
        SchemaOf::Inference => Document::Inference,
    };
    write::print(&write::pretty_json(&schema::of(document))?)
}
