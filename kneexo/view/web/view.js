"use strict";

/* The page of `kneexo view`: legs with their recorded runs. */
{
  const read = (id) => JSON.parse(document.getElementById(id).textContent);
  const stage = new Stage(document.getElementById("stage"), { legs: read("legs") });
  read("runs").forEach((run, index) => {
    const columns = Object.entries(run).map(([name, text]) => [name, Stage.unpack(text)]);
    stage.setRun(index, Object.fromEntries(columns));
  });
  window.stage = stage;
}
