"use strict";
// Shows one night at a time: the one in the address, or the newest; the arrow keys go to the night before and after it.
{
  const nights = [...document.querySelectorAll(".one")]; // newest first
  const days = new Map([...document.querySelectorAll(".month a")].map(day => [day.hash.slice(1), day]));
  let selected = 0;
  const select = index => {
    selected = index;
    nights.forEach((night, k) => night.classList.toggle("selected", k === index));
    for (const [name, day] of days) day.toggleAttribute("aria-current", name === nights[index].id);
  };
  const follow = () => { // an address such as #changes selects no night
    const index = nights.findIndex(night => night.id === decodeURIComponent(location.hash.slice(1)));
    if (index >= 0) select(index);
  };
  if (nights.length) {
    document.documentElement.classList.add("scripted");
    select(0);
    follow();
    addEventListener("hashchange", follow);
    addEventListener("keydown", event => {
      const index = selected + {ArrowLeft: 1, ArrowRight: -1}[event.key];
      if (!(index in nights) || event.altKey || event.ctrlKey || event.metaKey) return;
      location.replace(`#${nights[index].id}`);
    });
  }
}
